"""The pages that people read, and the sentences of one."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
FOLDERS = sorted(page for page in ROOT.glob("*/README.md") if not page.parent.name.startswith("."))
READ = (*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", ROOT / "SECURITY.md", *FOLDERS)
ABBREVIATIONS = ("e.g.", "i.e.", "cf.", "vs.", "etc.", "et al.", "Eq.", "Eqs.", "Fig.", "Figs.")


def sentences(text: str) -> list[str]:
    """The sentences of a page: code is one word, a link its text; list items and table cells stand alone.

    Headings, code blocks, formulas on lines of their own and what a command wrote (from a comment with its name to
    ``<!-- end -->``) are left out.
    """
    text = re.sub(r"^```.*?^```$", "\n", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"<!-- (?!end)[^>]*-->.*?<!-- end -->", "\n", text, flags=re.DOTALL)
    text = re.sub(r"^\$\$.*?\$\$$", "\n", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"^(?:#.*|\|[-:| ]+\||!\[.*)$", "", text, flags=re.MULTILINE)
    text = re.sub(r"`[^`]+`|\$[^$]+\$", "Code", text)
    text = re.sub(r"!?\[([^]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"^\|.*$", lambda row: row[0].replace("|", "\n\n"), text, flags=re.MULTILINE)
    text = re.sub(r"^ *(?:[-*+>]|\d+\.) ", "\n", text, flags=re.MULTILINE)
    found = []
    for block in re.split(r"\n\s*\n", text):
        begun: list[str] = []
        for word in block.split():
            begun.append(word)
            bare = word.strip("\"'()[]*_")
            ends = word.rstrip("\"')]*_").endswith((".", "!", "?")) and bare != "..."
            if ends and not any(" ".join(begun).rstrip("\"')]*_").endswith(a) for a in ABBREVIATIONS):
                found.append(" ".join(begun))
                begun = []
        found.append(" ".join(begun))
    return [sentence for sentence in found if sentence]
