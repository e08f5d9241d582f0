"""The suite's end of the engine's process: start it, ask it, stop it when it takes too long."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from pathlib import Path
from typing import Any

import twinbench

ROOT = Path(__file__).resolve().parents[2]
"""Holds ``examples/``, in a checkout and in a wheel."""
PACKAGES = Path(twinbench.__file__).parents[1]


class Engine:
    """A blind process that answers one case after another, so that an engine compiles once.

    Args:
        checkout: of Twinbench, whose code answers; this one if None.
    """

    def __init__(self, keep_out: Path, log: Path, checkout: Path | None = None) -> None:
        self.keep_out, self.log, self.checkout = keep_out, log, checkout
        self._process: subprocess.Popen[str] | None = None

    def ask(self, folder: Path, engine: str, timeout_s: float) -> dict[str, Any]:
        """The verdict of ``engine`` ("module:function") on the case in ``folder``; one that failed if there is none."""
        process = self._running()
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(json.dumps({"folder": str(folder), "engine": engine}) + "\n")
            process.stdin.flush()
            ready, _, _ = select.select([process.stdout], [], [], timeout_s)
            said = process.stdout.readline() if ready else ""
        except BrokenPipeError:
            ready, said = [process.stdout], ""
        if not said:
            self.close()
            why = "its process ended" if ready else f"no answer within {timeout_s:g} s"
            return {"verdict": "failed", "says": why, "findings": [], "seconds": timeout_s}
        return dict(json.loads((folder / "verdict.json").read_text()))

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def _running(self) -> subprocess.Popen[str]:
        if self._process is None or self._process.poll() is not None:
            packages = os.pathsep.join([str(self.checkout or PACKAGES), os.environ.get("PYTHONPATH", "")])
            with open(self.log, "a") as log:
                blind = [sys.executable, "-P", "-m", "twinbench.proof.blind", str(self.keep_out)]
                self._process = subprocess.Popen(
                    blind,
                    cwd=self.checkout or ROOT,
                    env=os.environ | {"PYTHONPATH": packages},
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=log,
                    text=True,
                )
        return self._process
