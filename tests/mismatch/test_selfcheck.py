"""Decoys, halves and sizes against closed forms, a dense Gaussian, and the engine on recordings of a motor."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record
from motor_friction import CATALOGUE
from scipy.stats import multivariate_normal, norm

from twinbench.mismatch.asked import Asked
from twinbench.mismatch.friction import SMOOTH
from twinbench.mismatch.naming import power as power_module
from twinbench.mismatch.naming.answer import PLAIN, Answer
from twinbench.mismatch.naming.decision import CREDIBLE
from twinbench.mismatch.naming.ground import Products
from twinbench.mismatch.naming.marginal import Reduced, one_sided
from twinbench.mismatch.naming.odds import one_more
from twinbench.mismatch.naming.picture import Picture
from twinbench.mismatch.naming.power import CLOSE, SHOWN, WANTED, Draws, power
from twinbench.mismatch.naming.selfcheck import (
    BLURRED,
    DECOYS,
    Pieces,
    Rival,
    SelfCheck,
    checked,
    is_said,
    likeliest,
    named_decoys,
    nearer,
    unlike,
)
from twinbench.mismatch.naming.sets import Sets
from twinbench.mismatch.naming.weighed import weighed
from twinbench.mismatch.sensors import SensorNoise
from twinbench.physics.simulator import Array, Variable

DRY = "coulomb_friction@omega_rad_s"


def sets_of(G: Array, functions: int = 0, bounded: bool = False, prior: float = -2.0) -> Sets:
    """Effects, then functions of one port; nothing was read yet."""
    v = len(G) - functions
    return Sets(
        reduced=Reduced(G, np.zeros(len(G)), 0.0),
        group=np.zeros(functions, dtype=int),
        prior=np.full(v, prior),
        bounded=np.full(v, bounded),
        family=np.arange(v),
        usable=np.ones(v, dtype=bool),
        s=np.array([0.5]),
        since=np.full(v, -np.inf),
    )


def picture_of(sets: Sets, names: tuple[str, ...], high: float = 1e6) -> Picture:
    def candidate(name):
        mechanism = SimpleNamespace(parameters=(Variable("size", "N", -high, high, 0.0),))
        return SimpleNamespace(name=name, mechanism=mechanism, null=np.zeros(1))

    return Picture(
        variants=tuple(range(len(names))),
        since=sets.since,
        candidates=tuple(map(candidate, names)),
        odds=sets.prior,
        units=np.full(len(names), 2.0),
        least=np.full(len(names), 2.0),
        products=Products(np.empty((1, 0, 0)), np.empty((1, 0, 0)), np.empty((1, 0, 0))),
        sets=sets,
        log=0.0,
        excess=0.0,
    )


def chance(size: float, g: float, prior: float, bounded: bool) -> float:
    """That an effect's evidence over nothing is twenty to one, from the tail of a normal.

    Args:
        size: in prior sds; the prior is as wide as the effect is large, if it is larger.
        g: square of its column.
    """
    wide = max(1.0, size) ** 2
    b = g * size + np.linspace(-8.0, 8.0, 40_001) * np.sqrt(g)
    variance = 1.0 / (g + 1.0 / wide)
    log = 0.5 * np.log(variance / wide) + 0.5 * variance * b**2 + prior
    log += one_sided(variance * b, np.full(len(b), np.sqrt(variance)), np.full(len(b), bounded))
    density = norm.pdf(b, g * size, np.sqrt(g))
    return float(np.sum(density[log > PLAIN]) * (b[1] - b[0]))


@pytest.mark.parametrize("bounded", [False, True])
@pytest.mark.parametrize("size", [0.1, 0.3, 0.6, 3.0])
def test_an_effect_like_no_other_is_named_as_often_as_the_tail_of_a_normal_says(monkeypatch, size, bounded):
    monkeypatch.setattr(power_module, "SIMULATED", 20_000)
    g = 100.0
    draws = Draws(sets_of(g * np.eye(2), bounded=bounded), (0, 1), ("a", "b"), np.array([0.5]))
    assert draws.named(0, size) == pytest.approx(chance(size, g, -2.0, bounded), abs=0.02)


def test_the_size_of_nine_in_ten_is_where_the_tail_is_nine_tenths():
    g, rows = 400.0, 900
    one, other = power(picture_of(sets_of(g * np.eye(2)), ("a", "b")), rows, np.array([0.5]))
    size = one.size_90 / 2.0  # in prior sds
    assert chance(size / CLOSE**2, g, -2.0, False) < WANTED < chance(size * CLOSE, g, -2.0, False)
    assert one.shows_90 == pytest.approx(size * np.sqrt(g / rows))
    for level, p in zip(SHOWN, one.probabilities, strict=True):
        assert p == pytest.approx(chance(level * np.sqrt(rows / g), g, -2.0, False), abs=0.15)
    assert (one.name, one.unit, one.alike) == ("a", "N", ())
    assert other.name == "b"


def test_a_size_that_it_cannot_have_is_none():
    # It shows as 1/3 of the noise at most; the table's larger sizes are none, and at 1/3 it would be named.
    small = power(picture_of(sets_of(100.0 * np.eye(1)), ("a",), high=2.0), 900, np.array([0.5]))[0]
    assert np.isfinite(small.probabilities).tolist() == [True, True, False, False]
    assert small.size_90 is not None
    assert small.size_90 <= 2.0
    tiny = power(picture_of(sets_of(100.0 * np.eye(1)), ("a",), high=0.1), 900, np.array([0.5]))[0]
    assert tiny.size_90 is None
    assert tiny.shows_90 is None


def test_the_same_column_under_two_names_is_never_named_alone():
    G = 400.0 * np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    one, other, third = power(picture_of(sets_of(G), ("a", "b", "c")), 900, np.array([0.5]))
    assert one.alike == ("b",)
    assert other.alike == ("a",)
    assert third.alike == ()
    assert one.size_90 is not None, "the two together are as plain as one"
    # Where sizes have one sign only, the column of the other sign is another thing.
    turned = sets_of(G * np.outer([1, -1, 1], [1, -1, 1]), bounded=True)
    assert power(picture_of(turned, ("a", "b", "c")), 900, np.array([0.5]))[0].alike == ()


def test_a_rival_nearby_has_to_be_told_apart_as_well():
    g, cosine = 400.0, 0.98
    G = g * np.array([[1.0, cosine], [cosine, 1.0]])
    draws = Draws(sets_of(G), (0, 1), ("a", "b"), np.array([0.5]))
    alone = Draws(sets_of(g * np.eye(2)), (0, 1), ("a", "b"), np.array([0.5]))
    assert draws.alike(0) == ()
    assert draws.named(0, 0.4) < 0.3 < 0.9 < alone.named(0, 0.4)
    # Evidence against the rival, (b_a^2 - b_b^2) / 2 g, has mean g size^2 (1 - cosine^2) / 2, and has to be log 19.
    enough = np.sqrt(2.0 * np.log(CREDIBLE / (1.0 - CREDIBLE)) / (g * (1.0 - cosine**2)))
    assert draws.named(0, 0.5 * enough) < 0.3
    assert draws.named(0, 3.0 * enough) > 0.9


def test_the_discrepancy_takes_what_it_can_explain_as_where_its_size_is_learnt():
    rng = np.random.default_rng(5)
    X = rng.normal(size=(300, 7))
    X[:, 0] = X[:, 3:] @ [1.0, -0.5, 0.7, 0.3] + 0.5 * X[:, 0]  # mostly what the functions can do
    sets, s = sets_of(X.T @ X, functions=4), np.array([0.05])
    draws = Draws(sets, (0, 1, 2), ("a", "b", "c"), s)
    free = Draws(sets_of(X[:, :3].T @ X[:, :3]), (0, 1, 2), ("a", "b", "c"), s)
    size = 0.3
    hidden = draws.named(0, size)
    assert free.named(0, size) > hidden + 0.3
    many = 0
    for _ in range(60):
        y = X[:, 0] * size + X[:, 3:] @ (s * rng.normal(size=4)) + rng.normal(size=300)
        tried = replace(sets, reduced=Reduced(X.T @ X, X.T @ y, 0.0), s=s, known={})
        logs = [tried.score((k,)).log for k in range(3)]
        many += logs[0] - tried.score(()).log > PLAIN and logs[0] > max(logs[1:]) + 3.0
    assert 0.1 < hidden < 0.9
    assert many / 60 == pytest.approx(hidden, abs=0.2)


N, V, F = 2, 4, 3


@pytest.fixture
def dense() -> tuple[Array, Array, Pieces]:
    """White columns (R, B, K) and readings (R, B) of two recordings in four pieces each, and their products."""
    rng = np.random.default_rng(2)
    X = rng.normal(size=(2, 40, N + V + F))
    y = X @ np.r_[0.3, -0.2, 1.5, 0.0, 0.0, 0.0, 0.1, -0.1, 0.2] + rng.normal(size=(2, 40))
    both = np.concatenate((X, y[:, :, None]), axis=2).reshape(2, 4, 10, -1)
    products = np.einsum("rpbi,rpbj->rpij", both, both)
    prior, bounded = np.array([-1.0, -2.0, -3.0, -4.0]), np.array([True, False, False, False])
    return X, y, Pieces(products, np.array([0.5, 0.0]), prior, bounded, np.array([0, 0, 1]), np.array([0.4, 0.2]), V)


def gaussian(X: Array, y: Array, pieces: Pieces, key: tuple[int, ...], s: Array) -> float:
    """Evidence of a set over white noise alone, by the dense covariance of readings (B,)."""
    J, effects, functions = X[:, :N], X[:, [N + k for k in key]], X[:, N + V :]
    cov = np.eye(len(y)) + J @ J.T + effects @ effects.T + functions * s[pieces.group] ** 2 @ functions.T
    return float(multivariate_normal(J @ pieces.mean, cov).logpdf(y) - np.sum(norm.logpdf(y)))


def test_several_effects_have_the_odds_of_so_many_as_in_the_answer(dense):
    _, _, pieces = dense
    half, key = np.ones((2, 4), dtype=bool), (1, 3)
    unnamed, two = (pieces.logs(half, [Rival(names, key, pieces.s, 0.0)])[0] for names in ((), ("a", "b")))
    # Of V candidates V (V - 1) / 2 pairs are as likely as V single ones.
    assert two - unnamed == pytest.approx(np.log(V**2 / (V * (V - 1) / 2)))


def test_one_more_decoy_has_the_odds_of_one_effect_more():
    assert one_more(0, 31) == pytest.approx(0.0)
    assert one_more(1, 31) == pytest.approx(np.log(31**2 / (31 * 30 / 2)))
    assert one_more(31, 31) == 0.0
    rng = np.random.default_rng(4)
    X = rng.normal(size=(300, 31))
    X *= 10.0 / np.linalg.norm(X, axis=0)
    noise = rng.normal(size=300)

    def named(size: float, another: float) -> set[int]:
        return named_decoys(read(X, X[:, 0] + size * X[:, 7] + noise), [(0,)], tuple(range(1, 21)), another)

    # Between the size that is named with these odds and without lies one that is named only with them.
    sizes = np.linspace(0.2, 0.8, 61)
    plain, helped = ([7 in named(size, odds) for size in sizes] for odds in (0.0, one_more(2, 31)))
    assert not plain[0]
    assert plain[-1]
    assert sum(helped) > sum(plain)
    assert all(h or not p for h, p in zip(helped, plain, strict=True))


@pytest.mark.parametrize("key", [(), (1,), (1, 3)])
def test_evidence_on_pieces_is_that_of_a_dense_gaussian(dense, key):
    X, y, pieces = dense
    half = np.array([[True, False, True, False], [False, True, True, False]])
    rows = np.repeat(half, 10, axis=1)
    s = np.array([0.3, 0.6])
    (log,), (none,) = (pieces.logs(half, [Rival((), k, s, 0.0)]) for k in (key, ()))
    expected = [gaussian(X[rows], y[rows], pieces, k, s) for k in (key, ())]
    prior = float(pieces.prior[list(key)].sum())
    assert log - none == pytest.approx(expected[0] - expected[1] + prior, abs=1e-6)


def test_a_size_of_one_sign_has_a_half_normal_prior(dense):
    X, y, pieces = dense
    every, s = np.ones((2, 4), dtype=bool), pieces.s
    (log,), (none,) = (pieces.logs(every, [Rival((), k, s, 0.0)]) for k in ((0,), ()))
    flat = X.reshape(-1, X.shape[2])
    expected = gaussian(flat, y.ravel(), pieces, (0,), s) - gaussian(flat, y.ravel(), pieces, (), s) - 1.0
    assert log - none == pytest.approx(expected + np.log(2.0), abs=1e-6), "plainly positive: twice as likely"


def test_halves_hold_half_of_each_recording_and_then_the_rest():
    pieces = Pieces(
        np.zeros((3, 8, 2, 2)), np.zeros(0), np.zeros(1), np.zeros(1, bool), np.zeros(0, int), np.ones(1), 1
    )
    halves = list(pieces.halves(np.random.default_rng(0)))
    assert len(halves) == 10
    for first, second in zip(halves[::2], halves[1::2], strict=True):
        assert (first.sum(axis=1) == 4).all()
        assert (first ^ second).all()
    assert len({h.tobytes() for h in halves}) > 5


def test_the_likeliest_in_a_half_is_what_the_half_speaks_for(dense):
    _, _, pieces = dense
    rivals = [
        Rival(("a",), (0,), pieces.s, 10.0),
        Rival((), (), pieces.s, 0.0),
        Rival(("a", "b"), (0, 1), pieces.s, np.nan),
    ]
    ahead = nearer(pieces, rivals)
    every = np.ones((2, 4), dtype=bool)
    assert pieces.logs(every, rivals)[:2] + ahead[:2] == pytest.approx([10.0, 0.0])
    assert ahead[2] == ahead[0], "never at its own fixed point: as the first"
    first = np.arange(4) < 2
    half = np.array([first, first])
    assert likeliest(pieces, rivals, half, np.zeros(3)) == ("a",)
    # One that looks otherwise from where it stands is believed half of that, and nothing where it is far off.
    two = [Rival((n,), (k,), pieces.s, 0.0) for n, k in (("b", 2), ("c", 1))]
    behind = float(np.subtract(*pieces.logs(half, two)))
    assert 0.0 < behind < 0.4 * BLURRED
    assert likeliest(pieces, two, half, np.array([0.0, 1.9 * behind])) == ("b",)
    assert likeliest(pieces, two, half, np.array([0.0, 2.1 * behind])) == ("c",)
    assert likeliest(pieces, two, half, np.array([0.0, 1.1 * BLURRED])) == ("b",)
    # Two effects have to be twenty times likelier than one.
    more = [two[0], Rival(("b", "c"), (1, 2), pieces.s, 0.0)]
    free = replace(pieces, prior=np.zeros(4))
    wanted = 2.0 * (float(np.subtract(*free.logs(half, more))) + PLAIN)
    assert 0.0 < wanted < 0.9 * BLURRED
    assert likeliest(free, more, half, np.array([0.0, 0.95 * wanted])) == ("b",)
    assert likeliest(free, more, half, np.array([0.0, 1.05 * wanted])) == ("b", "c")


def test_the_same_is_what_was_said_one_for_one():
    said = [{"a", "b"}, {"c"}]
    assert is_said(("c", "b"), said)
    assert is_said(("a", "c"), said)
    assert not is_said(("a", "b"), said)
    assert not is_said(("a",), said)
    assert not is_said(("a", "c", "d"), said)
    assert is_said((), [])
    assert not is_said(("a",), [])
    many = [f"effect {k}" for k in range(20)]
    assert is_said(tuple(many), [{name} for name in reversed(many)]), "as many orders as 20! are not tried"


def with_decoys(seed: int, readings: Array, colour: Array) -> Sets:
    """Thirty-one columns, coloured by a filter (B, B); white noise is taken for granted."""
    X = colour @ np.random.default_rng(seed).normal(size=(len(colour), 31))
    return read(10.0 * X / np.linalg.norm(X, axis=0), readings)


def read(X: Array, readings: Array) -> Sets:
    """Columns (B, V) with readings (B,); the discrepancy has a function that does nothing."""
    X = np.column_stack((X, np.zeros(len(X))))
    sets = sets_of(X.T @ X, functions=1, prior=-np.log(31.0))
    return replace(sets, reduced=Reduced(X.T @ X, X.T @ readings, 0.0))


def test_no_decoy_is_named_in_noise_that_is_what_it_is_taken_for_and_some_are_in_other_noise():
    colour = np.tril(np.ones((200, 200))) / 10.0  # a random walk
    decoys = tuple(range(1, 21))
    named = {"white": 0, "walk": 0}
    for seed in range(10):
        white = np.random.default_rng(100 + seed).normal(size=200)
        named["white"] += len(named_decoys(with_decoys(seed, white, colour), [], decoys))
        named["walk"] += len(named_decoys(with_decoys(seed, colour @ white, colour), [], decoys))
    assert named["white"] == 0
    assert named["walk"] > 10


def test_a_decoy_that_is_there_is_named_beside_an_effect_and_in_its_place():
    rng = np.random.default_rng(4)
    X = rng.normal(size=(300, 31))
    X *= 10.0 / np.linalg.norm(X, axis=0)
    noise = rng.normal(size=300)

    def named(readings, effects):
        return named_decoys(read(X, readings), effects, tuple(range(1, 21)))

    assert named(noise, []) == set()
    assert named(X[:, 0] + noise, [(0,)]) == set()
    assert named(X[:, 0] + X[:, 7] + noise, [(0,)]) == {7}
    assert 7 in named(X[:, 7] + noise, [(0,)])


def test_a_decoy_is_no_parameter_and_like_nothing_that_may_be_there():
    G = np.eye(5)
    G[0, 2] = G[2, 0] = 0.9
    sets = replace(sets_of(G), usable=np.array([True, True, True, False, True]))
    assert unlike(sets, (2, 3, 4)) == (4,)
    assert unlike(sets_of(np.diag([1.0, 0.0, 1.0, 0.0])), (2, 3)) == (2,)
    many = sets_of(np.eye(1 + 2 * DECOYS))
    assert unlike(many, tuple(range(1, 1 + 2 * DECOYS))) == tuple(range(1, 1 + DECOYS))


def test_what_is_said_is_one_sentence_each():
    good, bad = SelfCheck(0, 20, 9, (9,), 10, ()), SelfCheck(3, 20, 2, (4,), 10, ())
    assert good.says == (
        "Of 20 effects that are certainly not there, none would be named.",
        "The same is the likeliest in 9 of 10 halves of the recordings.",
    )
    assert bad.says[0].endswith("three would be named: the noise or the discrepancy is not right here.")


def answer_with(size: float) -> Answer:
    """Of two recordings of a motor with dry friction of a size in rad/s^2, as the catalogue has it."""
    width = SMOOTH * next(v.scale for v in MOTOR.states if v.name == "omega_rad_s")

    def extra(t, x, u):
        return np.array([0.0, -size * np.tanh(x[1] / width), 0.0])

    return weighed(Asked(MOTOR, [record(f"run {s}", s, extra) for s in (1, 2)], [], CATALOGUE)).answer


@pytest.fixture(scope="module")
def sound() -> Answer:
    return answer_with(0.0)


@pytest.fixture(scope="module")
def of_sound(sound) -> SelfCheck:
    return checked(sound)


def test_a_sound_motor_stays_sound_in_halves_and_among_decoys(sound, of_sound):
    assert not sound.found
    assert of_sound.decoys_named == 0
    assert DECOYS // 2 < of_sound.decoys <= DECOYS
    assert (of_sound.named_again, of_sound.each_again, of_sound.halves) == (10, (), 10)
    assert {p.name for p in of_sound.power} == {m.name for m in CATALOGUE}
    assert len(of_sound.power) == len(CATALOGUE)
    assert len(of_sound.says) == 2


def test_it_says_the_same_whenever_it_is_asked(sound, of_sound):
    assert checked(sound) == of_sound


def test_friction_is_named_well_above_the_size_that_it_states_and_not_well_below(of_sound):
    (dry,) = [p for p in of_sound.power if p.name == DRY]
    above, below = answer_with(2.0 * dry.size_90), answer_with(dry.size_90 / 3.0)
    assert [f.name for f in above.found] == [DRY]
    assert not below.found
    of_above = checked(above)
    assert of_above.decoys_named == 0
    assert of_above.named_again >= 7
    assert of_above.again == (of_above.each_again[0] / 10,)
    assert of_above.each_again[0] >= of_above.named_again
    assert DRY not in {p.name for p in of_above.power}, "it is named"


def test_decoys_are_named_where_the_noise_is_taken_for_a_fifth_of_what_it_is(sound):
    ground = sound.naming.ground
    small = SensorNoise(ground.noise.white / 25.0, ground.noise.coloured / 25.0, ground.noise.memory)
    wrong = replace(ground, noise=small, white=tuple(5.0 * w for w in ground.white), FF=25.0 * ground.FF)
    assert checked(replace(sound, naming=replace(sound.naming, ground=wrong))).decoys_named > 2
