"""A page shows the files that it names, and a file that is missing changes nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinbench.common.errors import BadInput
from twinbench.common.page_marks import blocks, fill, filled, main

PAGE = (
    "# Title\n\nWords.\n\n<!-- results/run/a.md -->\nold\n<!-- end -->\n\nMore.\n<!-- results/b.md -->\n<!-- end -->\n"
)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "results/run").mkdir(parents=True)
    (tmp_path / "docs").mkdir()
    (tmp_path / "results/run/a.md").write_text("## New\n\n| a |\n| --- |\n", encoding="utf-8")
    (tmp_path / "results/b.md").write_text("- ×1.2 [0.9–1.5]\n", encoding="utf-8")
    (tmp_path / "docs/page.md").write_text(PAGE, encoding="utf-8")
    (tmp_path / "README.md").write_text("No block, <!-- a comment --> and <!-- end -->.\n", encoding="utf-8")
    return tmp_path


def test_each_block_becomes_its_file_and_the_rest_stays(root):
    assert fill(root) == [root / "docs/page.md"]
    text = (root / "docs/page.md").read_text(encoding="utf-8")
    assert blocks(text) == [("results/run/a.md", "## New\n\n| a |\n| --- |\n"), ("results/b.md", "- ×1.2 [0.9–1.5]\n")]
    assert text.startswith("# Title\n\nWords.\n\n<!-- results/run/a.md -->\n## New\n")
    assert "<!-- end -->\n\nMore.\n<!-- results/b.md -->\n" in text
    assert (root / "README.md").read_text() == "No block, <!-- a comment --> and <!-- end -->.\n"


def test_filled_again_nothing_changes(root, capsys):
    fill(root)
    assert fill(root) == []
    assert main(root) == 0
    assert capsys.readouterr().out == "filled: nothing had changed\n"


def test_a_missing_file_is_one_line_and_changes_no_page(root, capsys):
    (root / "results/b.md").unlink()
    with pytest.raises(BadInput, match=r"results/b\.md"):
        fill(root)
    assert (root / "docs/page.md").read_text(encoding="utf-8") == PAGE
    assert main(root) == 2
    assert capsys.readouterr().err.count("\n") == 1


@given(st.text(alphabet=st.characters(exclude_characters="\r", exclude_categories=("Cs",))))
def test_a_page_without_marks_stays_as_it_is(text):
    assert blocks(text) or filled(text, Path("nowhere")) == text
