"""Pages as a browser lays them out: at 1280 and 390 px nothing overflows, on paper no column is cut."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
from helpers.oven import loss_found
from helpers.sample_run import write_run

from twinbench.bench.report.write import write_report
from twinbench.mismatch.report.write import write_page

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--allow-file-access-from-files",
)  # fmt: skip
WIDTHS_PX = (1280, 390)
LEAST_TYPE_PX = 10.0
"""Type in figures; they are set in 8 pt, 10.7 px, and must not shrink below that much."""
MEASURE = """
const measured = {};
addEventListener('load', () => {
  for (const frame of document.querySelectorAll('iframe')) {
    const w = frame.contentWindow, d = w.document;
    const inBox = e => e.closest('.scroll') !== null;
    measured[frame.name] = {
      inner: w.innerWidth, wide: d.scrollingElement.scrollWidth,
      out: [...d.body.querySelectorAll('*')]
        .filter(e => !inBox(e) && e.getBoundingClientRect().right > w.innerWidth + 1)
        .map(e => e.tagName + '.' + e.className).slice(0, 9),
      boxes: [...d.querySelectorAll('.main .scroll')].map(e => [e.clientWidth, e.scrollWidth]),
      figures: [...d.querySelectorAll('figure')].map(f => {
        const svg = f.querySelector('svg');
        return [f.id, f.clientWidth, svg ? svg.getBoundingClientRect().width : 0, svg ? svg.viewBox.baseVal.width : 0];
      }),
    };
  }
  document.body.textContent = JSON.stringify(measured);
});
"""

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium or Chrome on this machine")


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A report of eight estimators, and one of a mismatch with a name."""
    report, mismatch = (tmp_path_factory.mktemp(name) for name in ("report", "mismatch"))
    write_report(write_run(report, seconds=300))
    write_page(loss_found(), mismatch)
    return {"report": report / "report.html", "mismatch": mismatch / "report.html"}


def browse(folder: Path, *arguments: str) -> str:
    assert BROWSER is not None
    command = [BROWSER, *FLAGS, f"--user-data-dir={folder / 'profile'}", *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout


def laid_out(pages: dict[str, Path], folder: Path) -> dict[str, dict[str, Any]]:
    """What the browser makes of each page at each width, by ``page-width``; all in one go."""
    frames = [
        f'<iframe name="{name}-{width}" src="{page.as_uri()}" style="width:{width}px; height:900px; border:0"></iframe>'
        for name, page in pages.items()
        for width in WIDTHS_PX
    ]
    wrapper = folder / "wrapper.html"
    wrapper.write_text(f"<!doctype html><body>{''.join(frames)}<script>{MEASURE}</script></body>")
    said = browse(folder, "--window-size=1600,1000", "--dump-dom", wrapper.as_uri())
    found = re.search(r"<body>(.*)</body>", said, re.DOTALL)
    assert found is not None
    return json.loads(html.unescape(found[1]))  # type: ignore[no-any-return]


@pytest.fixture(scope="module")
def layout(pages: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    return laid_out(pages, tmp_path_factory.mktemp("layout"))


@pytest.mark.parametrize("width", WIDTHS_PX)
@pytest.mark.parametrize("name", ["report", "mismatch"])
def test_no_page_is_wider_than_its_window(layout: dict[str, dict[str, Any]], name: str, width: int) -> None:
    found = layout[f"{name}-{width}"]
    assert found["inner"] == width
    assert found["wide"] <= width
    assert found["out"] == []


def test_the_comparison_fits_its_column(layout: dict[str, dict[str, Any]]) -> None:
    ((column, needed),) = layout["report-1280"]["boxes"]
    assert needed <= column


@pytest.mark.parametrize("name", ["report", "mismatch"])
def test_figures_use_a_screen_and_stay_readable_on_a_phone(layout: dict[str, dict[str, Any]], name: str) -> None:
    for width in WIDTHS_PX:
        drawn = [f for f in layout[f"{name}-{width}"]["figures"] if f[2]]
        assert len(drawn) >= 4
        for figure, column, px, pt in drawn:
            assert 8.0 * px / pt >= LEAST_TYPE_PX, (figure, width)
            if width == 1280:
                assert px > 0.9 * min(column, 1.75 * pt * 4 / 3), figure


def test_what_overflows_would_be_noticed(pages: dict[str, Path], tmp_path: Path) -> None:
    wide = tmp_path / "wide.html"
    wide.write_text(pages["report"].read_text().replace("<h2", '<div style="width:700px">wide</div><h2', 1))
    found = laid_out({"report": wide}, tmp_path)["report-390"]
    assert found["wide"] > 390
    assert "DIV." in found["out"]


def words_on_paper(page: Path, folder: Path) -> tuple[str, list[str]]:
    """All words of the printed page, and those that stand beyond its edges."""
    if shutil.which("pdftotext") is None:
        pytest.skip("no pdftotext on this machine")
    browse(folder, "--no-pdf-header-footer", f"--print-to-pdf={folder / 'page.pdf'}", page.as_uri())
    subprocess.run(["pdftotext", "-bbox", folder / "page.pdf", folder / "page.xml"], check=True, timeout=60)
    root = ET.fromstring((folder / "page.xml").read_text(encoding="utf-8"))
    said, beyond = [], []
    for sheet in (e for e in root.iter() if e.tag.endswith("}page")):
        for word in sheet:
            said.append(word.text or "")
            if float(word.get("xMin", 0)) < 0 or float(word.get("xMax", 0)) > float(sheet.get("width", 0)):
                beyond.append(word.text or "")
    return "".join("".join(said).split()), beyond


def words_of_tables(page: Path) -> list[set[str]]:
    """Per table: the words of its heads, and of the last cell of each row."""
    tables = re.findall(r"<table>(.*?)</table>", page.read_text(encoding="utf-8"), re.DOTALL)
    found = []
    for table in tables:
        heads = re.findall(r"<th[^>]*>(.*?)</th>", table, re.DOTALL)
        last = [re.findall(r"<td[^>]*>(.*?)</td>", row, re.DOTALL)[-1:] for row in table.split("</tr>")]
        text = " ".join([*heads, *(cell for row in last for cell in row)])
        found.append(set(re.split(r"[\s–]+", html.unescape(re.sub(r"<[^>]+>", " ", text)).strip())))
    return found


@pytest.mark.parametrize("name", ["report", "mismatch"])
def test_no_column_is_cut_on_paper(pages: dict[str, Path], name: str, tmp_path: Path) -> None:
    said, beyond = words_on_paper(pages[name], tmp_path)
    assert beyond == []
    tables = words_of_tables(pages[name])
    assert len(tables) >= 3
    assert [word for table in tables for word in table if word not in said] == []
    if name == "report":
        assert "Meanabsoluteerrorofcapacity" in said, "definitions are folded on a screen, not on paper"


def test_a_cut_column_would_be_noticed(pages: dict[str, Path], tmp_path: Path) -> None:
    """As if the print rules stood before the others."""
    page = tmp_path / "cut.html"
    late = "@media print { .scroll { overflow-x: auto; width: 50% } table { width: auto } td { white-space: nowrap } }"
    page.write_text(pages["report"].read_text().replace("</style>", f"{late}</style>", 1))
    said, beyond = words_on_paper(page, tmp_path)
    assert beyond or [word for table in words_of_tables(page) for word in table if word not in said]
