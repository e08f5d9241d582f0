"""The house keeps its size: short files, short functions, few parameters, one meaning for each constant's name."""

from __future__ import annotations

import ast
import statistics
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = ("common", "physics", "machines", "data", "methods", "baselines", "mismatch", "bench", "proof")
FILES = {str(p.relative_to(ROOT)): p.read_text() for room in ROOMS for p in sorted((ROOT / room).rglob("*.py"))}
TREES = {path: ast.parse(text) for path, text in FILES.items()}


def functions() -> Iterator[tuple[str, ast.FunctionDef]]:
    """Every function and method, with the file that it is in."""
    for path, tree in TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                yield f"{path}: {node.name}", node


def test_files_and_functions_are_short():
    lengths = {path: len(text.splitlines()) for path, text in FILES.items()}
    assert statistics.median(lengths.values()) <= 110
    assert {path: n for path, n in lengths.items() if n > 400} == {}
    own = {name: f.end_lineno - f.lineno + 1 for name, f in functions() if f.end_lineno is not None}
    assert {name: n for name, n in own.items() if n > 60} == {}


def compiled(function: ast.FunctionDef) -> bool:
    return any(
        "njit" in (d := ast.unparse(each)) or "register_jitable" in d or "vectorize" in d
        for each in function.decorator_list
    )


def test_no_public_function_but_a_compiled_one_takes_more_than_seven_parameters():
    """Compiled kernels take plain arrays: records of them would be unpacked at every call."""
    many = {}
    for name, function in functions():
        a = function.args
        count = len([x for x in (*a.posonlyargs, *a.args, *a.kwonlyargs) if x.arg not in ("self", "cls")])
        if count > 7 and not function.name.startswith("_") and not compiled(function):
            many[name] = count
    assert many == {}


def numbers(tree: ast.Module) -> Iterator[tuple[str, float]]:
    """Names of a module's constants that are set to a number, with it."""
    for node in tree.body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        for target in targets:
            several = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
            pairs = zip(target.elts, node.value.elts, strict=True) if several else ((target, node.value),)
            for name, value in pairs:
                try:
                    number = eval(compile(ast.Expression(value), "", "eval"), {"__builtins__": {}})
                except (NameError, AttributeError, TypeError):
                    continue
                if isinstance(name, ast.Name) and type(number) in (int, float):
                    yield name.id.lstrip("_"), number


LAYOUT = {"ZETA", "PROBE", "SIZE", "BIAS", "NOISE", "ERROR"}
"""Where each part of a filter's state begins: one meaning, with a place of its own in each estimator's state."""


def test_a_constant_of_one_name_has_one_value_in_the_whole_package():
    where = defaultdict(dict)
    for path, tree in TREES.items():
        for name, number in numbers(tree):
            where[name][path] = number
    several = {name: at for name, at in where.items() if len(set(at.values())) > 1 and name not in LAYOUT}
    assert several == {}
