"""All that machine code depends on, in one hash: a function's bytecode, constants, closure, globals and callees."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterator
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic

from twinbench.common.filespec import USER_FILE

_PLAIN = (type(None), bool, int, float, complex, str, bytes)
_PACKAGES = ("numpy", "numba", "llvmlite")
_LIBRARIES = ("builtins", "math", *_PACKAGES)
"""What these hold is settled by their versions. A function of Python that says it is of ``builtins`` has no module."""


class Untold(Exception):
    """The function depends on something whose content cannot be told."""


def fingerprint(function: Callable[..., Any]) -> str:
    """Equal for two functions only if numba makes the same of them, in this process or another.

    Raises:
        Untold: the function uses an object of which we cannot say so.
    """
    digest = hashlib.sha256(f"{sys.version} {np.__version__} {numba.__version__}".encode())
    # Machine code on the disk looks for the module of what it calls: under another file's name it finds none.
    digest.update(str(getattr(function, "__module__", "")).encode())
    for part in _told(function, []):
        digest.update(f"{len(part)}:".encode())
        digest.update(part)
    return digest.hexdigest()


def _told(value: Any, seen: list[Any]) -> Iterator[bytes]:
    """The content of a value that a function uses; of a function or code again of all it uses."""
    yield type(value).__name__.encode()
    if isinstance(value, Dispatcher):
        if not _is_only_one(value):
            raise Untold(f"the compiled function {value.py_func.__qualname__}, whose name may have two meanings")
        yield repr(sorted(value.targetoptions.items())).encode()
        value = value.py_func
    if isinstance(value, FunctionType) and _home(value) not in _PACKAGES:
        if value in seen:
            yield str(seen.index(value)).encode()
            return
        seen.append(value)
        if value.__module__ not in sys.modules:
            raise Untold(f"{value.__qualname__}, whose module is not to be found")
        yield from _told(value.__code__, seen)
        yield from _told(value.__defaults__, seen)
        yield from _told(tuple(sorted((value.__kwdefaults__ or {}).items())), seen)
        for name in sorted(_names(value.__code__) & value.__globals__.keys()):
            yield name.encode()
            yield from _told(value.__globals__[name], seen)
        for cell in value.__closure__ or ():
            yield from _told(cell.cell_contents, seen)
    elif isinstance(value, CodeType):
        yield from (value.co_code, value.co_exceptiontable)
        names = (value.co_names, value.co_varnames, value.co_freevars, value.co_cellvars)
        yield repr((names, value.co_argcount, value.co_kwonlyargcount, value.co_flags)).encode()
        yield from _told(value.co_consts, seen)
    elif type(value) in _PLAIN:
        yield repr(value).encode()
    elif isinstance(value, tuple) and (type(value) is tuple or hasattr(value, "_fields")):
        yield repr((len(value), getattr(value, "_fields", ()))).encode()
        for item in value:
            yield from _told(item, seen)
    elif isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
        yield f"{value.dtype.str} {value.shape}".encode()
        yield value.tobytes()
    elif isinstance(value, _Intrinsic):
        yield from _told(value._defn, seen)
    elif isinstance(value, ModuleType) and value.__name__.partition(".")[0] in _LIBRARIES:
        yield value.__name__.encode()
    elif callable(value) and _is_library(value):
        yield f"{_home(value)} {getattr(value, '__qualname__', None) or value.__name__}".encode()
    else:
        raise Untold(f"a {type(value).__name__}")


def _is_only_one(function: Dispatcher) -> bool:
    """No other function has its name: to the linker they would be one, and the code of either would run."""
    module, name = function.py_func.__module__, function.py_func.__qualname__
    passing = module == "__main__" or module.startswith(USER_FILE)
    return not passing and getattr(sys.modules.get(module), name, None) is function


def _is_library(value: Any) -> bool:
    owner = getattr(value, "__self__", None)  # of a method: it would have to be told too
    return _home(value) in _LIBRARIES and (owner is None or isinstance(owner, ModuleType))


def _home(value: Any) -> str:
    """The top-level package in which something is defined."""
    module: str = getattr(value, "__module__", None) or type(value).__module__
    return module.partition(".")[0]


def _names(code: CodeType) -> set[str]:
    """Globals that code uses, in nested functions too."""
    inner = (c for c in code.co_consts if isinstance(c, CodeType))
    return set(code.co_names).union(*map(_names, inner))
