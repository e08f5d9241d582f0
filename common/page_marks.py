"""What stands on a page between the marks of a file is that file: ``make pages`` fills all of them.

A mark is a comment with the name of a file below results/, alone on its line; ``<!-- end -->`` ends the block. So no
figure of a comparison is typed by hand: whoever runs the comparison again fills the pages again.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from twinbench.common.errors import BadInput
from twinbench.common.store import write_text

BLOCK = re.compile(r"^<!-- (results/[\w./-]+) -->\n(.*?)^<!-- end -->$", re.DOTALL | re.MULTILINE)
"""A block: the file's name, and what stands there now."""
PAGES = ("*.md", "docs/*.md", "results/*.md")
"""Where pages are, from the top of the repository."""


def blocks(text: str) -> list[tuple[str, str]]:
    """Name and content of each block of a page."""
    return [(name, content) for name, content in BLOCK.findall(text)]


def filled(text: str, root: Path) -> str:
    """A page with each block as its file is now.

    Args:
        root: top of the repository, from which files are named.

    Raises:
        BadInput: a file that a mark names cannot be read.
    """

    def block(found: re.Match[str]) -> str:
        try:
            content = (root / found[1]).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise BadInput(
                f"{found[1]}: a page shows it and it cannot be read ({error}); run what writes it"
            ) from error
        return f"<!-- {found[1]} -->\n{content}<!-- end -->"

    return BLOCK.sub(block, text)


def pages(root: Path) -> Iterator[Path]:
    """Every page that may hold a block, in the order of their names."""
    for pattern in PAGES:
        yield from sorted(root.glob(pattern))


def fill(root: Path) -> list[Path]:
    """Fill all pages, none if one of them cannot be filled; returns those that changed.

    Raises:
        BadInput: a file that a mark names cannot be read.
    """
    before = {page: page.read_text(encoding="utf-8") for page in pages(root)}
    after = {page: filled(text, root) for page, text in before.items()}
    changed = [page for page, text in after.items() if text != before[page]]
    for page in changed:
        write_text(page, after[page])
    return changed


def main(root: Path) -> int:
    """Exit status: 0, or 2 where a file is missing, which one line says."""
    try:
        changed = fill(root)
    except BadInput as error:
        print(f"twinbench.common.page_marks: {error}", file=sys.stderr)
        return 2
    names = ", ".join(str(page.relative_to(root)) for page in changed)
    print(f"filled: {names or 'nothing had changed'}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(Path.cwd()))
