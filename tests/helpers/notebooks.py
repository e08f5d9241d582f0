"""The notebooks of docs/, run as Jupyter runs them. ``python tests/helpers/notebooks.py`` stores what they show now."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode

NOTEBOOKS = sorted((Path(__file__).parents[2] / "docs" / "notebooks").glob("*.ipynb"))
LONGEST_CELL_S = 500
"""Wall-clock time; a cell takes seconds where nothing else runs."""


def stored(path: Path) -> NotebookNode:
    """A notebook as it lies in the repository."""
    return nbformat.read(path, as_version=4)


def executed(path: Path, folder: Path) -> NotebookNode:
    """The same after a run in a folder, where it may write; a cell that fails is an error."""
    notebook = stored(path)
    run = NotebookClient(
        notebook,
        timeout=LONGEST_CELL_S,
        kernel_name="python3",
        record_timing=False,
        resources={"metadata": {"path": str(folder)}},
    )
    run.execute()
    for cell in notebook.cells:
        if cell.cell_type == "code":  # progress and its times are of one run only
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
    notebook.metadata = {"kernelspec": notebook.metadata.kernelspec, "language_info": {"name": "python"}}
    return notebook


def refresh() -> None:
    """Run every notebook and store it with what it shows."""
    for path in NOTEBOOKS:
        with tempfile.TemporaryDirectory() as folder:
            nbformat.write(executed(path, Path(folder)), path)
        print(path.name, file=sys.stderr)


if __name__ == "__main__":
    refresh()
