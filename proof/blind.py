"""The engine's own process in the concealed-effect suite: it sees a case's folder and nothing else of the suite.

``python -m twinbench.proof.blind KEEP_OUT ...`` reads one JSON request per line from stdin: ``{"folder": ..., "engine":
"module:function"}``, with the recordings and ``case.json`` in the folder; it writes ``verdict.json`` there and
answers with one line. Before anything else is imported it gives up, for good, the right to import
``proof.concealed``, to open a file of that package, of a KEEP_OUT folder or of another process, and to start
processes. (An audit hook cannot be taken off again. It guards against a slip, not against native code that
means harm; the truth, moreover, is on no disk while the engine runs.)
"""

from __future__ import annotations

import json
import os
import re
import sys
import time
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from pathlib import Path
from typing import Any

from twinbench.common.orphans import end_with_parent

_CONCEALED = "twinbench.proof.concealed"
_HERE = Path(__file__).resolve().parent
_PROCESSES = {
    "subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "os.forkpty",
    "pty.spawn", "os.startfile",
}  # fmt: skip
_FILES = {"open", "os.listdir", "os.scandir", "os.link", "os.symlink", "os.rename"}


class _Refuse(MetaPathFinder):
    """Finds nothing; refuses what is concealed."""

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> None:
        if fullname == _CONCEALED or fullname.startswith(_CONCEALED + "."):
            raise ImportError(f"{fullname} is concealed from the engine")


def conceal(keep_out: Sequence[Path]) -> None:
    """Give up the right to look, in this process, for good."""
    sys.meta_path.insert(0, _Refuse())
    roots = [os.path.realpath(p) for p in (_HERE / "concealed", *keep_out)]
    others = re.compile(rf"/proc/(?!{os.getpid()}(/|$))\d+(/|$)")

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        if event in _PROCESSES:
            raise PermissionError("the engine's process may start no other")
        if event not in _FILES:
            return
        for argument in arguments[:2]:
            if not isinstance(argument, str | bytes | os.PathLike):
                continue
            path = os.path.realpath(os.fsdecode(argument))
            if others.match(path) or any(path == root or path.startswith(root + os.sep) for root in roots):
                raise PermissionError(f"{path} is concealed from the engine")

    sys.addaudithook(watch)


def answer(folder: Path, engine: str) -> dict[str, Any]:
    """Run an engine on the case in a folder; its verdict as JSON."""
    import importlib
    from dataclasses import replace

    from twinbench.mismatch.model import whole_catalogue
    from twinbench.mismatch.recordings import read_recordings
    from twinbench.proof.twins import left, simulator_of

    case = json.loads((folder / "case.json").read_text())
    simulator = simulator_of(case["simulator"], case.get("network", {}))
    simulator = replace(simulator.with_values(**case["values"]), calibrate=tuple(case["calibrate"]), drifts=())
    names = [*case["train"], *case["held_out"]]
    recordings = read_recordings([folder / f"{name}.csv" for name in names], simulator)
    fitted, held_out = recordings[: len(case["train"])], recordings[len(case["train"]) :]
    period_s = float(fitted[0].time_s[1] - fitted[0].time_s[0])
    catalogue = left(whole_catalogue(simulator, (), period_s), case["without"])
    if "only" in case:  # the oracle is told
        catalogue = tuple(m for m in catalogue if m.name in case["only"])
    module, _, function = engine.partition(":")
    run = getattr(importlib.import_module(module), function)
    verdict = run(simulator, fitted, hold_out=held_out, catalogue=catalogue)
    return dict(verdict if isinstance(verdict, dict) else verdict.to_dict())


def serve() -> None:
    """Answer requests from stdin until it ends."""
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what an engine prints is no answer
    for line in sys.stdin:
        request = json.loads(line)
        folder, began = Path(request["folder"]), time.process_time()  # whatever else the machine does
        try:
            verdict = answer(folder, request["engine"])
        except Exception as error:  # whatever an engine raises is its answer
            verdict = {"verdict": "failed", "says": f"{type(error).__name__}: {error}", "findings": []}
        verdict["seconds"] = time.process_time() - began
        (folder / "verdict.json").write_text(json.dumps(verdict))
        replies.write("done\n")
        replies.flush()


if __name__ == "__main__":
    end_with_parent()
    conceal([Path(argument) for argument in sys.argv[1:]])
    serve()
