"""The verdict on one page: a PDF of one A4 sheet with the sentence, the findings and the figures, all of it on it."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import pytest
from helpers.documents import NOWHERE
from helpers.oven import LOSS, loss_found
from matplotlib.figure import Figure
from matplotlib.text import Text

from twinbench.common.style import styled
from twinbench.mismatch import Verdict
from twinbench.mismatch.report.sheet import A4_MM, sheet, write_sheet

POINTS_PER_MM = 72.0 / 25.4


@pytest.fixture(scope="module")
def crowded() -> Verdict:
    """More and longer than one page holds."""
    verdict = loss_found()
    (named,) = verdict.findings
    names: dict[str, Any] = {"mechanism": "overflow_" * 9 + "@level_cm", "indistinguishable_from": ("a", "b")}
    long = dataclasses.replace(named, since_s=60.0, **names)
    nameless = dataclasses.replace(named, mechanism=None, best="leak@p_bar", probability=0.43, parameters=())
    return dataclasses.replace(verdict, says=verdict.says + " and so on" * 99, findings=(named, long, nameless) * 9)


@styled
def laid_out(figure: Figure) -> list[Text]:
    """Every text that is seen; all have their places."""
    figure.draw_without_rendering()
    texts: list[Text] = figure.findobj(Text)  # type: ignore[assignment]
    return [text for text in texts if text.get_text().strip() and text.get_visible()]


def test_one_a4_page_that_a_reader_can_search(tmp_path: Path) -> None:
    write_sheet(loss_found(), NOWHERE, tmp_path)
    content = (tmp_path / "report.pdf").read_bytes()
    assert content.startswith(b"%PDF-")
    assert b"/Count 1 " in content
    (box,) = re.findall(rb"/MediaBox \[ 0 0 (\S+) (\S+) \]", content)
    assert [float(side) for side in box] == pytest.approx([side * POINTS_PER_MM for side in A4_MM], abs=0.1)
    assert b"/Type3" not in content, "its text could not be copied"


def test_the_sheet_has_the_sentence_the_findings_and_both_figures() -> None:
    verdict = loss_found()
    texts = [text.get_text() for text in laid_out(sheet(verdict, NOWHERE))]
    assert verdict.says in " ".join(texts)
    (finding,) = verdict.findings
    for cell in (LOSS.name, finding.kind, str(finding.port), finding.parameters[0].words(), "above 0.99"):
        assert cell in " ".join(texts), cell
    for said in ("Measured and simulated, held out: sunday", "simulator after", "monday", "tuesday", "error / noise"):
        assert said in texts, said
    assert any(text.startswith("Twinbench 0.0.0; 2026-01-01") for text in texts)


def test_what_is_too_much_is_counted_and_nothing_leaves_the_page(crowded: Verdict) -> None:
    figure = sheet(crowded, NOWHERE)
    texts = laid_out(figure)
    for text in texts:
        place, page = text.get_window_extent(), figure.bbox
        assert page.x0 <= place.x0 < place.x1 <= page.x1, text.get_text()
        assert page.y0 <= place.y0 < place.y1 <= page.y1, text.get_text()
    said = [text.get_text() for text in texts]
    shown = said.count("missing physics")
    (more,) = (text for text in said if text.endswith(" more, which report.html has"))
    assert 0 < shown == 27 - int(more.split()[1])
    assert {"–", "0.43"} <= set(said)
    for cell in ("without a name; leak@p_bar", "overflow_overflow_"):
        assert any(text.startswith(cell) for text in said), cell


def test_a_figure_that_fails_leaves_the_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: Any) -> None:
        raise ValueError("no\nroom")

    monkeypatch.setattr("twinbench.mismatch.report.sheet.draw_over_time", fails)
    write_sheet(loss_found(), NOWHERE, tmp_path)
    assert b"/Count 1 " in (tmp_path / "report.pdf").read_bytes()
    texts = [text.get_text() for text in laid_out(sheet(loss_found(), NOWHERE, "drawing it failed"))]
    assert LOSS.name in texts
    assert "Not drawn: drawing it failed" in texts
