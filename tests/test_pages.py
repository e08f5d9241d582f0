"""What pages say of the estimators: tables as their files are, no sentence by hand, and facts that the code has."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from helpers.prose import PAGES, READ, ROOT, sentences

from twinbench.bench.registry import discover
from twinbench.bench.roster import LABELS, WEIGHS_STEPS
from twinbench.common.page_marks import blocks, pages
from twinbench.data.benchmark import DesignConfig
from twinbench.data.population import BEGIN_MIN, BLOCK, COMMISSIONING_S, RAMP_MIN, SIZE
from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.estimator import Estimator

TABLES = (
    "comparison", "health", "skill", "following", "calibrated", "regimes_calibrated", "paired", "claims", "single",
)  # fmt: skip
SHOWN = {
    "README.md": {"paper/answer.md", "paper/tables/comparison.md"},
    "docs/reproduction.md": {
        "paper/answer.md", "paper/paper_says.md", *(f"paper/tables/{name}.md" for name in TABLES),
        "first_seed/parts_say.md", "first_seed/steps_say.md", "first_seed/worth_say.md",
        "first_seed/tables/ablations.md",
        "paper/parts_say.md", "paper/faults_say.md", "paper/tables/fault_kinds.md",
        *(f"coverage/tables/{name}.md" for name in ("right_pairs", "regimes_calibrated", "exact_posterior")),
    },
    "docs/three_machines.md": {
        "machines/machines.md",
        *(f"{m}/{name}.md" for m in ("two_tanks", "motor") for name in ("answer", "tables/comparison")),
    },
    "docs/compare.md": {f"compare/{m}/tables/recordings.md" for m in ("cascaded_tanks", "train_compressor")},
    "docs/estimators.md": {"paper/tables/cost.md"},
    "docs/latency.md": {"latency/latency.md", "latency/memory.md", "paper_time/tables/cost.md"},
    "docs/deeponet_kalman.md": {
        f"delay/tables/{name}.md" for name in ("delays", "slope_forecasts", "slope_corrections")
    },
    "docs/exams.md": {f"exams/{name}/answers.md" for name in ("petab_select", "causal_chambers")},
    "docs/sizes_over_time.md": {"histories/histories.md"},
    "docs/fleet.md": {"fleets/fleets.md", "fleets_earlier/fleets.md"},
    "docs/first_hour.md": {
        *(f"real_recordings/{name}/look.md" for name in ("cascaded_tanks", "air_chamber_b", "train_compressor")),
        *(
            f"real_recordings/{name}/says.md"
            for name in ("cascaded_tanks", "air_chamber_b", "air_chamber_tight", "train_compressor")
        ),
    },
    "docs/proof.md": {
        "proof/gates.md", "proof/fits.md", "opponents/engines.md", "opponents/paired.md",
        "flagship/gates_known_health.md",
    },
}  # fmt: skip
"""The files that each page shows."""

COMPARES = re.compile(
    r"\b(better|worse|best|worst|beats?|beaten|wins?|won|ahead of|outperforms?|superior|inferior|strongest|weakest|"
    r"(?:more|less|most|least) (?:accurate|error)|errs? (?:less|more|least|most)|smallest error|passes the)\b",
    re.IGNORECASE,
)
"""Words that compare what estimators are worth. Speed has a page of its own, whose sentences have tests of theirs."""
NAMED = re.compile(
    "|".join(rf"(?<![\w-]){re.escape(name)}(?![\w-])" for name in (*LABELS.values(), *LABELS))
    + r"|\bthe oracle\b|\b(?:the|a) proposed method\b|\bmended EKF\b",
    re.IGNORECASE,
)


def names(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", [p for p in pages(ROOT) if blocks(p.read_text(encoding="utf-8"))], ids=names)
def test_every_block_is_its_file(page):
    for name, text in blocks(page.read_text(encoding="utf-8")):
        assert text == (ROOT / name).read_text(encoding="utf-8"), f"{name} has changed: make pages"


def test_the_pages_show_what_they_are_about():
    for page, wanted in SHOWN.items():
        shown = {name.removeprefix("results/") for name, _ in blocks((ROOT / page).read_text(encoding="utf-8"))}
        assert wanted <= shown, page


def comparisons(text: str) -> list[str]:
    """Sentences outside of blocks that name an estimator and say how good it is beside another."""
    bare = re.sub(r"`([a-z_]+)`", r"\1", text)
    return [s for s in sentences(bare) if NAMED.search(s) and COMPARES.search(s)]


def test_a_comparison_by_hand_would_be_found():
    block = "<!-- results/x.md -->\nGRU + KF is best.\n<!-- end -->\n"
    text = f"PINN + UKF beats all.\n\n{block}A `gru_kf` errs less here. Best is air."
    assert comparisons(text) == ["PINN + UKF beats all.", "A gru_kf errs less here."]


@pytest.mark.parametrize("page", [page for page in READ if page.name != "CHANGELOG.md"], ids=names)
def test_no_page_compares_estimators_by_hand(page):
    """Such sentences are written by the command that makes the tables, and decided by their tests."""
    assert comparisons(page.read_text(encoding="utf-8")) == []


def test_no_page_calls_anything_a_floor():
    for page in PAGES:
        assert not re.search(r"\b(?:true|lower) floor\b|\bfloor\b(?! of)", page.read_text(encoding="utf-8")), page.name


def facts() -> dict[str, dict[str, str]]:
    """The table of the page on the estimators, by estimator and column."""
    page = (ROOT / "docs/estimators.md").read_text(encoding="utf-8")
    head, _, *rows = (
        [cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines() if line.startswith("|")
    )
    return {row[0].strip("`"): dict(zip(head[1:], row[1:], strict=True)) for row in rows if row[0].startswith("`")}


def test_the_page_on_the_estimators_has_all_of_them():
    assert set(facts()) == set(discover())


def has_drift(kind: type[Estimator]) -> bool:
    """Does its code, or that which it builds on, know how the drift of the pressure sensors fades?"""
    modules = [sys.modules[base.__module__] for base in kind.__mro__]
    return any(hasattr(module, name) for module in modules for name in ("drift_keep", "sensor_keep"))


@pytest.mark.parametrize("name", discover())
def test_the_page_on_the_estimators_says_of_each_what_its_code_has(name):
    said, kind = facts()[name], discover()[name]
    assert (said["slow errors"] in ("yes", "none needed")) == ("slow_error" in kind.settings)
    assert (said["slow errors"] == "none needed") == (said["model"] == "plant")
    assert (said["weighs steps"] == "yes") == ("still" in kind.settings) == (name in WEIGHS_STEPS)
    assert (said["drift"] == "yes") == has_drift(kind)
    assert ("network" in said["trained"]) == ("iterations" in kind.settings)


def test_all_learners_are_shown_the_same_number_of_simulations():
    assert len({kind.settings["copies"] for kind in discover().values() if "copies" in kind.settings}) == 1


def test_the_recordings_are_as_many_as_the_page_says():
    config = DesignConfig()
    page = " ".join((ROOT / "docs/reproduction.md").read_text(encoding="utf-8").split())
    assert f"{config.n_train} to train, {config.n_validation} to validate" in page
    assert f"{config.n_calibration} to calibrate, {config.n_test} to test" in page
    assert f"{config.n_single} recordings of it" in page
    assert f"{config.minutes - config.warmup_minutes:g} minutes after a warm-up of {config.warmup_minutes:g}" in page
    assert f"Minutes 0 to {COMMISSIONING_S / 60:g} are" in page


def test_the_population_is_as_the_page_on_the_plant_says():
    page = " ".join((ROOT / "docs/plant.md").read_text(encoding="utf-8").split())
    counts = {n: BLOCK.count(n) for n in sorted(set(BLOCK))}
    assert counts == {0: 1, 2: 3, 3: 3, 4: 3}
    assert "In one of ten recordings nothing changes; in three each, two, three or four parameters do" in page
    assert f"between {SIZE[0]:g} and {SIZE[1]:g} of the parameter's life range" in page
    assert (
        f"from minute {BEGIN_MIN[0]:g} to {BEGIN_MIN[1]:g} and takes {RAMP_MIN[0]:g} to {RAMP_MIN[1]:g} minutes" in page
    )
    assert f"within {COMPRESSOR.health[-1].start[1]:g} K at the beginning" in page
