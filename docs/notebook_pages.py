"""The notebooks of docs/notebooks/ as pages of the site, with what they showed when they were stored."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nbformat
from mkdocs.structure.files import File, Files
from nbformat import NotebookNode

LINK = re.compile(r"\]\(([^)\s:]+)\.ipynb\)")
"""A link to a notebook, relative to its page."""


def on_files(files: Files, config: Any) -> Files:
    """Beside each notebook a page; the notebook itself stays, to be taken away."""
    for file in [file for file in files if file.src_uri.endswith(".ipynb")]:
        notebook = nbformat.read(str(file.abs_src_path), as_version=4)
        page = str(Path(file.src_uri).with_suffix(".md"))
        files.append(File.generated(config, page, content=as_page(notebook, file.name)))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Of links between pages and notebooks, the notebook's page; in the repository they lead to the notebook."""
    if page.file.generated_by:
        before, _, own = markdown.rpartition("\n")
        return LINK.sub(r"](\1.md)", before) + "\n" + own
    return LINK.sub(r"](\1.md)", markdown)


def as_page(notebook: NotebookNode, name: str) -> str:
    """Markdown of a notebook's cells and of what they showed; on the last line where to take it away."""
    parts = [part for cell in notebook.cells for part in _cell(cell)]
    return "\n\n".join([*parts, f"[This page is a notebook: take it away.]({name}.ipynb)"])


def _cell(cell: NotebookNode) -> Iterator[str]:
    if cell.cell_type == "markdown":
        yield cell.source
        return
    yield f"```python\n{cell.source}\n```"
    for output in cell.outputs:
        yield _output(output)


def _output(output: NotebookNode) -> str:
    """The richest form that a page of the site can show; pictures lie in the page, as in the notebook."""
    if output.output_type == "stream":
        return f"```text\n{output.text.rstrip()}\n```"
    data = output.data
    if "image/png" in data:
        return f'<img alt="Figure that the cell above draws" src="data:image/png;base64,{data["image/png"].strip()}">'
    if "text/markdown" in data:
        return str(re.sub(r"^#+ (.*)$", r"**\1**", data["text/markdown"], flags=re.MULTILINE))  # no headings of ours
    return f"```text\n{data['text/plain']}\n```"
