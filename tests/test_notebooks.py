"""The notebooks run, and show on the site what they show when they run; their prose keeps to the pages' rules."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from types import ModuleType

import pytest
from helpers.notebooks import NOTEBOOKS, executed, stored
from helpers.prose import ROOT, sentences
from helpers.site_code import site_code
from mkdocs.config import load_config
from nbformat import NotebookNode

LONGEST_WORDS = 35
NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e-?\d+)?")
names = [path.stem for path in NOTEBOOKS]


def shown(notebook: NotebookNode) -> list[list[dict[str, str]]]:
    """Per cell and output its kind and its text; of a picture only that it is there."""
    return [
        [
            {"kind": o.output_type, "text": o.text}
            if o.output_type == "stream"
            else {"kind": " ".join(sorted(o.data)), "text": str(o.data.get("text/markdown", o.data["text/plain"]))}
            for o in cell.outputs
        ]
        for cell in notebook.cells
        if cell.cell_type == "code"
    ]


def differences(before: NotebookNode, after: NotebookNode) -> list[str]:
    """Outputs that differ in a word, or in a number by more than a tenth, as processors and versions make them."""
    found = []
    for k, (old, new) in enumerate(zip(shown(before), shown(after), strict=True)):
        words = [[(o["kind"], NUMBER.sub("#", re.sub(r"[ \n]+", " ", o["text"]))) for o in cell] for cell in (old, new)]
        numbers = [[float(x) for o in cell for x in NUMBER.findall(o["text"])] for cell in (old, new)]
        if words[0] != words[1] or numbers[1] != pytest.approx(numbers[0], rel=0.1, abs=1e-6):
            found.append(f"code cell {k}: {new}")
    return found


@pytest.mark.parametrize("path", NOTEBOOKS, ids=names)
def test_a_notebook_shows_what_it_shows_when_it_runs(path: Path, tmp_path: Path) -> None:
    wrong = differences(stored(path), executed(path, tmp_path))
    assert not wrong, f"{path.name} has changed, make notebooks: {wrong}"


def test_a_change_would_be_found() -> None:
    before, after = stored(NOTEBOOKS[0]), stored(NOTEBOOKS[0])
    assert differences(before, after) == []
    said = next(cell for cell in after.cells if "run_battery" in cell.source).outputs[0]
    said.text = said.text.replace("'skip': 8", "'skip': 9")
    assert len(differences(before, after)) == 1
    said.text = stored(NOTEBOOKS[0]).cells[0].source
    assert len(differences(before, after)) == 1


def test_the_notebooks_estimator_is_the_example() -> None:
    cell = next(c for c in stored(ROOT / "docs/notebooks/add_a_baseline.ipynb").cells if "class Regression" in c.source)
    head, _, code = cell.source.partition("\n")
    assert head == "%%writefile regression.py"
    example = (ROOT / "examples/regression.py").read_text(encoding="utf-8")
    assert ast.dump(ast.parse(code)) == ast.dump(ast.parse(example))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=names)
def test_prose_is_as_short_as_that_of_pages_and_links_lead_somewhere(path: Path) -> None:
    text = "\n\n".join(cell.source for cell in stored(path).cells if cell.cell_type == "markdown")
    assert [s for s in sentences(text) if len(s.split()) > LONGEST_WORDS] == []
    links = re.findall(r"\]\(([^):]+)\)", text)
    assert links
    assert [link for link in links if not (path.parent / link).is_file()] == []


@pytest.fixture(scope="module")
def hook() -> ModuleType:
    return site_code("notebook_pages")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=names)
def test_the_site_takes_the_notebook_and_its_page_and_nothing_that_it_writes(path: Path) -> None:
    left_out = load_config(str(ROOT / "mkdocs.yml"), plugins=[], hooks=[])["exclude_docs"].match_file
    assert not left_out(f"notebooks/{path.name}")
    assert not left_out(f"notebooks/{path.stem}.md")
    assert left_out("notebooks/small.toml")
    assert left_out("notebooks/monday.csv")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=names)
def test_the_site_has_every_cell_and_every_output(hook: ModuleType, path: Path) -> None:
    notebook = stored(path)
    page = hook.as_page(notebook, path.stem)
    for cell in notebook.cells:
        assert cell.source in page
        for output in cell.get("outputs", ()):
            data = output.get("data", {"text/plain": output.get("text", "").rstrip()})
            best = next(kind for kind in ("image/png", "text/markdown", "text/plain") if kind in data)
            assert re.sub(r"^#+ ", "", data[best].strip()).splitlines()[-1] in page
    assert page.endswith(f"({path.name})")
    assert f"notebooks/{path.stem}.md" in (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
