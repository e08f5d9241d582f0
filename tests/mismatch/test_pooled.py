"""A fleet's evidence against dense Gaussians, and what it says of machines that share an effect and that do not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from twinbench.mismatch.fleet.evidence import Evidence, Known, Size, merged
from twinbench.mismatch.fleet.pooled import OWN, SCATTERS, UNTIED, pooled, weighed
from twinbench.mismatch.fleet.tied import MARK, shapes, tied, untied, with_tied
from twinbench.physics.simulator import Term, Variable

PRIOR_SD, NOISE_SD, CANDIDATES = 2.0, 0.1, 20
LEAK, LOSS = "leak", "loss"


def size_of(reading: float) -> tuple[float, Size]:
    """Nats for a size with a reading of it, against none, and the size."""
    told, own = NOISE_SD**-2, PRIOR_SD**-2
    sd = (told + own) ** -0.5
    log = norm.logpdf(reading, 0.0, np.hypot(NOISE_SD, PRIOR_SD)) - norm.logpdf(reading, 0.0, NOISE_SD)
    return float(log), Size(reading * told * sd**2, sd, PRIOR_SD, False)


def of(log: float, sizes: dict[str, Size]) -> Evidence:
    """Evidence of effects without a shape."""
    return Evidence(log, sizes, dict.fromkeys(sizes, ()))


def machine(leak: float, loss: float = 0.0) -> Known:
    """Readings of two sizes, each by a sensor of its own."""
    (by_leak, leak_size), (by_loss, loss_size) = size_of(leak), size_of(loss)
    return {
        frozenset(): (Evidence(0.0, {}, {}),),
        frozenset({LEAK}): (of(by_leak, {LEAK: leak_size}),),
        frozenset({LOSS}): (of(by_loss, {LOSS: loss_size}),),
        frozenset({LEAK, LOSS}): (of(by_leak + by_loss, {LEAK: leak_size, LOSS: loss_size}),),
    }


def test_another_prior_is_what_a_dense_gaussian_says() -> None:
    log, size = size_of(1.3)
    found = log + size.instead(np.array([1.0, 0.0]), np.array([0.2, PRIOR_SD]))
    dense = norm.logpdf(1.3, [1.0, 0.0], np.hypot([0.2, PRIOR_SD], NOISE_SD)) - norm.logpdf(1.3, 0.0, NOISE_SD)
    assert found == pytest.approx(dense, rel=1e-6)
    one_way = size._replace(one_way=True)
    assert size.instead(1.0 * np.ones(1), np.ones(1)) - one_way.instead(np.ones(1), np.ones(1)) == pytest.approx(
        np.log(2.0)
    )


def test_a_shared_effect_has_the_evidence_of_a_mean_and_a_scatter() -> None:
    """Of two machines that may have nothing else, by a dense Gaussian for each scatter."""
    readings = np.array([1.0, 1.04])
    fleet = {}
    for name, reading in zip("ab", readings, strict=True):
        log, size = size_of(float(reading))
        fleet[name] = {frozenset({LEAK}): (of(log, {LEAK: size}),)}
    usual = np.median([one[frozenset({LEAK})][0].sizes[LEAK].mean for one in fleet.values()])
    typical = []
    for share in SCATTERS:
        cov = (NOISE_SD**2 + (share * usual) ** 2) * np.eye(2) + PRIOR_SD**2
        typical.append(multivariate_normal.logpdf(readings, np.zeros(2), cov))
    none = multivariate_normal.logpdf(readings, np.zeros(2), NOISE_SD**2 * np.eye(2))
    expected = np.log(np.mean(np.exp(typical))) - none + 2 * np.log(1.0 - UNTIED) - np.log(CANDIDATES)
    # What is left are machines with a size that nothing ties to the other's: at most a twentieth each.
    assert weighed(fleet, [LEAK], CANDIDATES).log == pytest.approx(expected, abs=0.15)


def test_what_all_have_is_shared_and_what_one_has_is_its_own() -> None:
    rng = np.random.default_rng(4)
    fleet = {f"m{k}": machine(1.0 + 0.05 * rng.normal() + NOISE_SD * rng.normal(), 0.02) for k in range(8)}
    fleet["m3"] = machine(1.0, 1.2)
    fleet["m5"] = machine(3.0)
    fleet["m6"] = machine(0.0)
    best = pooled(fleet, CANDIDATES)[0]
    assert best.names == {LEAK}
    assert best.shared[LEAK].low < 1.0 < best.shared[LEAK].high
    assert {name for name, p in best.odd.items() if p > 0.5} == {"m3", "m5", "m6"}
    assert best.own["m3"][LOSS] > 0.99
    assert best.own["m5"][LEAK] > 0.99
    assert max(p for name, p in best.odd.items() if name not in ("m3", "m5", "m6")) < OWN


def test_machines_that_have_nothing_share_nothing() -> None:
    rng = np.random.default_rng(5)
    fleet = {f"m{k}": machine(*(NOISE_SD * rng.normal(size=2))) for k in range(6)}
    best = pooled(fleet, CANDIDATES)[0]
    assert not best.names
    assert max(best.odd.values()) < 0.1


def test_two_effects_may_be_shared() -> None:
    rng = np.random.default_rng(6)
    fleet = {f"m{k}": machine(*(np.array([1.0, 0.7]) + NOISE_SD * rng.normal(size=2))) for k in range(6)}
    best = pooled(fleet, CANDIDATES)[0]
    assert best.names == {LEAK, LOSS}
    assert best.shared[LOSS].mean == pytest.approx(0.7, abs=0.1)


def test_a_machine_may_have_the_shared_effect_in_another_place_than_its_own_likeliest() -> None:
    """A threshold that it hardly reached: by itself a lower one with a smaller size is a little likelier."""
    rng = np.random.default_rng(7)
    fleet = {f"m{k}": machine(1.0 + NOISE_SD * rng.normal()) for k in range(6)}
    (by_itself,) = fleet["m2"][frozenset({LEAK})]
    small = Evidence(by_itself.log + 1.0, {LEAK: Size(0.3, 0.02, PRIOR_SD, False)}, {LEAK: (12.0,)})
    alone = {**fleet["m2"], frozenset({LEAK}): (small,)}
    both = merged((alone, {frozenset({LEAK}): (by_itself,)}))
    assert len(both[frozenset({LEAK})]) == 2
    odd = [pooled({**fleet, "m2": known}, CANDIDATES)[0].odd["m2"] for known in (alone, both)]
    assert odd[0] > 0.9
    assert odd[1] < 0.2


def test_an_effect_in_the_shape_of_the_fleet_is_told_by_its_own_name() -> None:
    """The shape is that of the machine which sees it best, and hardly moves."""
    size = Size(1.0, 0.1, PRIOR_SD, False)
    dim = Evidence(3.0, {LEAK: size._replace(sd=0.5)}, {LEAK: (2.0,)})
    clear = Evidence(9.0, {LEAK: size}, {LEAK: (18.0,)})
    known = [{frozenset({LEAK}): (one,)} for one in (dim, clear)]
    assert shapes(known, (LEAK, LOSS)) == {LEAK: (18.0,)}
    rate, limit = Variable("rate", "1/s", 0.0, 1.0, 0.1, 0.1), Variable("limit", "cm", 0.0, 40.0, 20.0, 5.0)
    wave = Variable("wave", "1", -1.0, 1.0, 0.0, 1.0)
    acts = {"term": lambda x, u, theta: 0.0, "derivative": lambda x, u, theta: np.zeros(1), "states": (wave,)}
    held = tied(Term(LEAK, "it leaks", "balance:h_cm", (rate, limit), **acts), (18.0,))
    assert isinstance(held, Term)
    assert {v.name for v in held.brings}.isdisjoint({"rate", "limit", "wave"})
    assert (held.name, held.contains) == (LEAK + MARK, LEAK)
    assert held.parameters[1].nominal == 18.0
    assert held.parameters[1].high - held.parameters[1].low < 1.0
    sets = with_tied([frozenset({LEAK, LOSS}), frozenset({LOSS})], [LEAK])
    assert sets == {frozenset({held.name, LOSS})}
    told = untied({frozenset({held.name}): (Evidence(1.0, {held.name: size}, {held.name: (18.0,)}),)})
    assert told == {frozenset({LEAK}): (Evidence(1.0, {LEAK: size}, {LEAK: (18.0,)}),)}
