"""The page and its figures: in order, whole even where a figure fails, and with every name as its user wrote it."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import matplotlib.text
import numpy as np
import pytest
from helpers.oven import CATALOGUE, LOSS, OVEN, loss_found, page, record, write
from helpers.plain import diagnosed

from twinbench.data.recording import Recording
from twinbench.mismatch import Verdict
from twinbench.mismatch.faults import faults
from twinbench.mismatch.report.figures import draw
from twinbench.mismatch.spikes import Spike
from twinbench.mismatch.verdict import conclude
from twinbench.physics.compose import with_mechanism

AWKWARD = "$p^{2", "a_b & <b>"
"""Names that a formula, or HTML, would be read out of."""


@pytest.fixture(scope="module")
def named() -> Verdict:
    return loss_found()


def visible(text: str) -> str:
    """What a reader sees of a page: no tags, no style, no drawing."""
    return re.sub(r"<(style|svg)\b.*?</\1>|<[^>]*>", " ", text, flags=re.DOTALL)


def test_the_page_is_one_sentence_one_figure_then_the_list(named: Verdict, tmp_path: Path) -> None:
    write(named, tmp_path)
    text = page(tmp_path)
    places = [text.index(part) for part in ("<h1", '<figure id="fit_held_out"', '<ul class="points"', "<table")]
    assert places == sorted(places)
    assert text.index("<figure") == places[1]
    assert len(re.findall(r"<li>", text[places[2] : text.index("</ul>", places[2])])) == len(named.points)
    assert text.count("<details") >= 3, "definitions are folded"


def test_minus_signs_are_minus_signs(named: Verdict, tmp_path: Path) -> None:
    fit = tuple(e._replace(change_low=-21.5, change_high=-15.5) for e in named.fit)
    value = dataclasses.replace(named.parameters[0], value=-3.0, low=-4.0, high=-2.0)
    write(dataclasses.replace(named, fit=fit, parameters=(value,)), tmp_path)
    seen = visible(page(tmp_path))
    assert "−21.5 to −15.5" in seen
    assert "−4 to −2" in seen
    assert not re.findall(r"(?<![\w.])-\d", seen)


def test_spikes_are_counted_in_words_listed_in_json_and_marked_in_the_figure(named: Verdict, tmp_path: Path) -> None:
    spikes = tuple(Spike("sunday", "probe_C", time_s, 900.0, 0, 0) for time_s in (40.0, 90.0))
    verdict = conclude(dataclasses.replace(named.diagnosis, spikes=spikes))
    assert "Taken out as spikes: two readings of probe_C." in verdict.points
    write(verdict, tmp_path)
    told = json.loads((tmp_path / "verdict.json").read_text())["spikes"]
    assert told == [{"recording": "sunday", "channel": "probe_C", "time_s": t, "value": 900.0} for t in (40.0, 90.0)]
    (figure,) = (drawing.figure for drawing in draw(verdict) if drawing.name == "fit_held_out")
    assert figure is not None
    whole = figure.axes[0]
    crosses = [line for line in whole.lines if line.get_marker() == "x"]
    assert [line.get_xdata()[0] for line in crosses] == [40.0, 90.0]  # type: ignore[index]
    assert all(line.get_ydata()[0] == whole.get_ylim()[1] < 900.0 for line in crosses)  # type: ignore[index]
    assert "taken out as a spike" in [text.get_text() for text in figure.legends[0].get_texts()]


def test_all_parameters_of_a_mechanism_are_in_the_words_with_units() -> None:
    """A sensor that ends at 170 degC is told with its 170 degC."""

    def clipped(name: str, seed: int) -> Recording:
        recording = record(OVEN, name, seed)
        values = recording.values.copy()
        ceiling = 170.0 + np.random.default_rng(seed).normal(0.0, 0.3, len(values))
        values[:, 1] = np.minimum(values[:, 1], ceiling)
        return dataclasses.replace(recording, values=values)

    listed = [m for m in faults(OVEN, 0.5) if m.name in ("sensor_saturation@probe_C", "sensor_bias@probe_C")]
    verdict = diagnosed(OVEN, [clipped("monday", 1), clipped("tuesday", 2)], [clipped("sunday", 3)], listed)
    assert verdict.verdict == "sensor fault"
    assert verdict.says.startswith("The sensor of probe_C does not go above a limit: on sunday the RMS error of ")
    (finding,) = verdict.findings
    size, limit = finding.parameters
    assert limit.value == pytest.approx(170.0, abs=0.5)
    assert f": {size.words('90 % interval ')}; {limit.says}: {limit.words()}." in finding.says
    assert re.search(r"highest value of probe_C: 1[67]\d\.?\d* degC \(1[67]\d\.?\d* to 1[67]\d", finding.says)


def renamed(recording: Recording) -> Recording:
    return dataclasses.replace(recording, channels=AWKWARD)


@pytest.fixture(scope="module")
def awkward() -> Verdict:
    heater, probe = (
        dataclasses.replace(v, name=n) for v, n in zip((*OVEN.inputs, *OVEN.outputs), AWKWARD, strict=True)
    )
    oven = dataclasses.replace(OVEN, inputs=(heater,), outputs=(probe,), states=(OVEN.states[0],))
    true = with_mechanism(OVEN, dataclasses.replace(LOSS, name="loss"))
    learnt = [renamed(record(true, name, seed)) for name, seed in (("$monday_", 1), ("<i>tuesday", 2))]
    return diagnosed(oven, learnt, [renamed(record(true, "^sunday^", 3))], CATALOGUE[:1])


def test_names_are_drawn_and_written_as_they_are(awkward: Verdict, tmp_path: Path) -> None:
    for drawing in draw(awkward):
        if drawing.figure is not None:
            texts = drawing.figure.findobj(matplotlib.text.Text)
            named = [t for t in texts if re.search(r"\$|\^|<", t.get_text())]  # type: ignore[attr-defined]
            assert not any(text.get_parse_math() for text in named)  # type: ignore[attr-defined]
    write(awkward, tmp_path)
    text = page(tmp_path)
    assert "Not drawn" not in text
    for name in ("$p^{2", "a_b &amp; &lt;b&gt;", "^sunday^", "&lt;i&gt;tuesday"):
        assert name in visible(text), name
    assert "& <b>" not in text
    assert "<i>" not in text


@pytest.mark.parametrize("where", ["twinbench.mismatch.report.figures.over_time", "twinbench.common.page.png"])
def test_a_figure_that_fails_loses_nothing_else(
    named: Verdict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], where: str
) -> None:
    def fails(*arguments: Any) -> None:
        raise ValueError("ParseException: Expected end of text,\nfound '$'")

    monkeypatch.setattr(where, fails)
    write(named, tmp_path)
    text = page(tmp_path)
    assert "Not drawn: drawing it failed, ValueError: ParseException: Expected end of text, found &#39;$&#39;" in text
    assert json.loads((tmp_path / "verdict.json").read_text())["verdict"] == "missing physics"
    assert (tmp_path / "figures" / "hypotheses.png").exists() == (where != "twinbench.common.page.png")
    assert capsys.readouterr() == ("", "")


def test_the_port_figure_says_what_the_verdict_says(named: Verdict) -> None:
    assert named.located is not None
    assert str(named.located.port) == str(named.findings[0].port) == "balance:T_C"
    assert all(f.ports[0][0] == f.port for f in named.findings)
    assert named.findings[0].ports[0][1] > 0.5
