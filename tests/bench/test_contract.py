"""The battery passes what keeps the contract and catches, by the promise meant for it, what does not."""

from __future__ import annotations

import sys
from functools import cache

import numpy as np
import pytest

from twinbench.bench.contract import PROMISES, Subject, judge, run_battery
from twinbench.bench.contract.filtering import textbook_filter
from twinbench.bench.contract.subject import record
from twinbench.bench.registry import discover
from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.estimator import Estimator, Info, State, gaussian_state
from twinbench.methods.frontend import FrontEnd, Memory
from twinbench.methods.kalman import linear_filter
from twinbench.methods.reporting import clean_flags

SCALE, P_DIS = COMPRESSOR.scales, COMPRESSOR.channels.index("p_dis_bar")
HIGH, LOW = COMPRESSOR.coordinates.high, COMPRESSOR.coordinates.low
ROOM = 0.05 * (HIGH - LOW)


@cache
def subject_of(name: str) -> Subject:
    return Subject(discover()[name])


def tried(name: str, promise: str):
    """Slow are two promises that train once more, of who is trained by the engine: all nominal filters make them."""
    again = promise.startswith(("where nothing is drawn", "settings that work online"))
    return pytest.param(name, promise, marks=[pytest.mark.slow] * (again and name == "nominal_ekf_mended"))


@pytest.mark.parametrize(("name", "promise"), [tried(n, p) for n in sorted(discover()) for p in PROMISES])
def test_every_registered_estimator_keeps_its_promises(name, promise):
    result = judge(promise, subject_of(name))
    if result.status == "skip":
        pytest.skip(result.detail)
    assert result.status == "pass", result.detail


class Good(Estimator):
    """The smallest estimator that promises everything: a regression on the gated readings."""

    name, draws, delayed = "good", False, True
    settings = {"implementation": "compiled", "inflation": 1.0}  # noqa: RUF012
    search_space = {"inflation": (0.5, 2.0)}  # noqa: RUF012
    online = frozenset({"inflation"})
    implementations = ("compiled", "written out")
    toy_filter = staticmethod(linear_filter)

    def fit(self, train, validation, seed):
        front_end = FrontEnd.fit(train)
        X = front_end.run(train.measured)[0][:, ::40].reshape(-1, 7)
        Y = train.truth.estimated[:, ::40].reshape(-1, 10)
        x, y = X.mean(axis=0), Y.mean(axis=0)
        W = np.linalg.lstsq(X - x, Y - y, rcond=None)[0]
        cov = np.cov((Y - y - (X - x) @ W).T) + np.diag((0.1 * SCALE) ** 2)
        self.arrays = {**front_end.arrays(), "x": x, "y": y, "W": W, "cov": cov}
        self.restore()

    def restore(self):
        self._front_end = FrontEnd.from_arrays(self.arrays)

    def init(self, batch):
        return self.reported(np.tile(self.arrays["y"], (batch, 1)), self._front_end.init(batch))

    def step(self, state, sample):
        front, clean = self._front_end.step(Memory(*state.memory), sample.measured)
        mean = self.arrays["y"] + np.einsum("bc,ce->be", clean.filled - self.arrays["x"], self.arrays["W"])
        innovation = np.where(clean.accepted, clean.filled, np.nan)[:, 4:] - COMPRESSOR.observe(state.mean)
        variance = np.tile([0.1, 9.0, 1e-3], (len(mean), 1))
        accepted = clean.accepted[:, 4:]
        nis = np.where(accepted.any(axis=1), np.nansum(innovation**2 / variance, axis=1), np.nan)
        S = variance[:, :, None] * np.eye(3)
        return self.reported(mean, front), Info(innovation, S, nis, accepted, clean_flags(clean), clean.age_s)

    def smooth(self, measured, ticks, delay_s=np.inf):
        """It learns nothing from what comes later."""
        kept = record(self, measured[:, : ticks[-1] + 1])
        parts = (kept.mean, kept.cov, kept.low, kept.high)
        return State(*(np.concatenate(part[ticks].swapaxes(0, 1)) for part in parts))

    def reported(self, mean, memory):
        mean = np.concatenate([mean[:, :5], np.clip(mean[:, 5:], LOW + ROOM, HIGH - ROOM)], axis=1)
        return gaussian_state(mean, self.arrays["cov"], tuple(memory))


def test_a_good_estimator_passes_all():
    results = run_battery(Good)
    assert [r.name for r in results] == list(PROMISES)
    assert [r for r in results if r.status != "pass"] == []


def test_the_textbook_filter_averages_what_it_is_told():
    """A constant seen n times under unit noise from a flat prior: the mean, with variance 1 / n."""
    one = np.eye(1)
    y = np.array([[3.0], [np.nan], [5.0], [10.0]])
    means, covs = textbook_filter(one, one, 0 * one, one, np.zeros(1), 1e8 * one, y)
    assert means[:, 0] == pytest.approx([3.0, 3.0, 4.0, 6.0], rel=1e-6)
    assert covs[:, 0, 0] == pytest.approx([1.0, 1.0, 1 / 2, 1 / 3], rel=1e-6)


class SearchesWhatIsNoSetting(Good):
    search_space = {"infaltion": (0.5, 2.0)}  # noqa: RUF012


class TakesAnySetting(Good):
    def __init__(self, machine=COMPRESSOR, **settings):
        super().__init__(machine, **{k: v for k, v in settings.items() if k in self.settings})


class DrawsWithoutTheSeed(Good):
    def fit(self, train, validation, seed):
        super().fit(train, validation, seed)
        self.arrays["y"] = self.arrays["y"] * (1.0 + 1e-6 * np.random.default_rng().random())


class DrawsThoughItSaysNot(Good):
    def fit(self, train, validation, seed):
        super().fit(train, validation, seed)
        self.arrays["y"] = self.arrays["y"] * (1.0 + 1e-6 * np.random.default_rng(seed).random())


class LearnsFromWhatWorksOnline(Good):
    def fit(self, train, validation, seed):
        super().fit(train, validation, seed)
        self.arrays["cov"] = self.config["inflation"] ** 2 * self.arrays["cov"]


class FillsGapsInTheTrainingData(Good):
    def fit(self, train, validation, seed):
        np.nan_to_num(train.measured, copy=False)
        super().fit(train, validation, seed)


class KeepsAViewOfTheTruth(Good):
    def fit(self, train, validation, seed):
        super().fit(train, validation, seed)
        self.arrays["y"] = train.truth.estimated[0, 0]
        self._truth = train.truth

    def step(self, state, sample):
        after, info = super().step(state, sample)
        return self.reported(after.mean + 0.01 * self._truth.health[0, 0, 0], after.memory), info


class ForgetsAnArray(Good):
    def save(self, path):
        whole, self.arrays = self.arrays, {k: v for k, v in self.arrays.items() if k != "W"}
        super().save(path)
        self.arrays = whole


class SavesWithPickle(Good):
    def save(self, path):
        with open(path, "wb") as file:
            np.savez(file, config=np.array([self.config], dtype=object), **self.arrays)


class RestoresTwiceAsMuch(Good):
    def restore(self):
        super().restore()
        self.arrays["y"] = self.arrays["y"] * 1.001


class CountsInInt32(Good):
    def step(self, state, sample):
        after, info = super().step(state, sample)
        return after, info._replace(flags=info.flags.astype(np.int32))


class WritesIntoItsState(Good):
    def step(self, state, sample):
        state.memory[0][:, -1] = 0.0
        return super().step(state, sample)


class RemembersOutsideItsState(Good):
    ticks = 0

    def step(self, state, sample):
        self.ticks += 1
        after, info = super().step(state, sample)
        return self.reported(after.mean + 1e-6 * self.ticks, after.memory), info


class ReusesItsBuffers(Good):
    def step(self, state, sample):
        after, info = super().step(state, sample)
        self._buffer = getattr(self, "_buffer", np.empty_like(info.nis))
        if self._buffer.shape != info.nis.shape:
            self._buffer = np.empty_like(info.nis)
        self._buffer[:] = info.nis
        return after, info._replace(nis=self._buffer)


class AveragesOverMachines(Good):
    def step(self, state, sample):
        after, info = super().step(state, sample)
        return self.reported(0.999 * after.mean + 0.001 * after.mean.mean(axis=0), after.memory), info


class LooksAhead(Good):
    """Python lets a caller's variables be reached, and with them whatever is stored there."""

    def step(self, state, sample):
        after, info = super().step(state, sample)
        whole = sys._getframe(1).f_locals.get("samples")
        peek = 0.0 if whole is None else np.nanmean(whole)
        return self.reported(after.mean + 1e-3 * peek, after.memory), info


class LooksTooFar(Good):
    def smooth(self, measured, ticks, delay_s=np.inf):
        known = super().smooth(measured, ticks)
        return known._replace(mean=known.mean + 1e-3 * np.nanmean(measured))


class AnswersInTheTypeOfTheReadings(Good):
    def step(self, state, sample):
        after, info = super().step(state, sample)
        return after._replace(mean=after.mean.astype(sample.measured.dtype)), info


class DiesOnNaN(Good):
    def step(self, state, sample):
        after, info = super().step(state, sample)
        return self.reported(after.mean + 0.0 * sample.measured.sum(axis=1)[:, None], after.memory), info


class Scarred(Good):
    """Once ``hurt``, for ever off: the last part of its memory counts the ticks on which it was."""

    def init(self, batch):
        fresh = super().init(batch)
        return fresh._replace(memory=(*fresh.memory, np.zeros(batch), np.zeros((batch, 7))))

    def step(self, state, sample):
        *front, hurt, last = state.memory
        after, info = super().step(state._replace(memory=tuple(front)), sample)
        hurt = hurt + self.hurt(sample.measured, last, info)
        off = np.where(hurt > self.patience, 40.0, 0.0)[:, None] * SCALE
        return self.reported(after.mean + off, (*after.memory, hurt, sample.measured)), info


class NeverForgivesAGap(Scarred):
    patience = 100

    def hurt(self, measured, last, info):
        return (info.age_s > 1.0).any(axis=1)


class NeverForgivesASpike(Scarred):
    patience = 20

    def hurt(self, measured, last, info):
        return (np.abs(measured - self.arrays["front.mean"]) > 40.0 * self.arrays["front.scale"]).any(axis=1)


class NeverForgivesAStuckSensor(Scarred):
    patience = 300

    def hurt(self, measured, last, info):
        return measured[:, P_DIS] == last[:, P_DIS]


class WaitsForTheFirstReading(Good):
    def init(self, batch):
        fresh = super().init(batch)
        front = Memory(*fresh.memory)
        return fresh._replace(memory=tuple(front._replace(filled=np.full_like(front.filled, np.nan))))


class LeavesTheBounds(Good):
    def reported(self, mean, memory):
        half = 2.0 * np.sqrt(np.diagonal(self.arrays["cov"]))
        cov = np.tile(self.arrays["cov"], (len(mean), 1, 1))
        return State(mean, cov, mean - half, mean + half, tuple(memory))


class Skewed(Good):
    def reported(self, mean, memory):
        after = super().reported(mean, memory)
        cov = after.cov.copy()
        cov[:, 0, 1] += 1e-3 * SCALE[0] * SCALE[1]
        return after._replace(cov=cov)


class Indefinite(Good):
    def reported(self, mean, memory):
        after = super().reported(mean, memory)
        sd = np.sqrt(np.diagonal(after.cov, axis1=1, axis2=2))
        return after._replace(cov=sd[:, :, None] * (2.0 * np.eye(10) - 1.0) * sd[:, None])


class TurnsIntervalsAround(Good):
    def reported(self, mean, memory):
        after = super().reported(mean, memory)
        return after._replace(low=after.high, high=after.low)


class NeverInDoubt(Good):
    def reported(self, mean, memory):
        after = super().reported(mean, memory)
        return after._replace(low=after.mean, high=after.mean)


class DoublesNIS(Good):
    def step(self, state, sample):
        after, info = super().step(state, sample)
        return after, info._replace(nis=2.0 * info.nis)


class MakesUpInnovations(Good):
    def step(self, state, sample):
        after, info = super().step(state, sample)
        return after, info._replace(innovation=np.nan_to_num(info.innovation))


class TellsNoGaps(Good):
    def step(self, state, sample):
        after, info = super().step(state, sample)
        return after, info._replace(flags=np.where(info.flags & 2, info.flags - 2, info.flags))


class TellsNoSpikes(Good):
    def step(self, state, sample):
        after, info = super().step(state, sample)
        return after, info._replace(flags=info.flags & 2)


class StaysYoung(Good):
    def step(self, state, sample):
        after, info = super().step(state, sample)
        return after, info._replace(age_s=np.minimum(info.age_s, 1.0))


class ForecastsInFloat32(Good):
    def forecast(self, state, inputs):
        return super().forecast(state, inputs).astype(np.float32)


class ForecastsNaN(Good):
    def forecast(self, state, inputs):
        said = super().forecast(state, inputs)
        said[:, 300:] = np.nan
        return said


class AdvancesByForecasting(Good):
    def forecast(self, state, inputs):
        state.mean[:, : len(COMPRESSOR.estimated)] *= 1.001
        return super().forecast(state, inputs)


class ReadsAllInputsAtOnce(Good):
    def forecast(self, state, inputs):
        return super().forecast(state, inputs) + 1e-3 * inputs.mean(axis=(1, 2))[:, None, None]


class DiffersWhenWrittenOut(Good):
    def step(self, state, sample):
        after, info = super().step(state, sample)
        off = 1e-6 if self.config["implementation"] == "written out" else 0.0
        return self.reported(after.mean + off, after.memory), info


class FiltersWithoutProcessNoise(Good):
    @staticmethod
    def toy_filter(F, H, Q, R, x0, P0):
        return linear_filter(F, H, 0.9 * Q, R, x0, P0)


CAUGHT = [
    (SearchesWhatIsNoSetting, "it declares itself consistently", "infaltion"),
    (TakesAnySetting, "an unknown setting is refused", "without a ValueError"),
    (DrawsWithoutTheSeed, "the same seed learns the same", "differ in y"),
    (DrawsThoughItSaysNot, "where nothing is drawn, another seed learns the same", "learns another y"),
    (LearnsFromWhatWorksOnline, "settings that work online are not learnt from", "learns another cov"),
    (FillsGapsInTheTrainingData, "fit leaves the recordings as they were", "changed the training"),
    (KeepsAViewOfTheTruth, "only fit reads the truth", "change with the truth"),
    (ForgetsAnArray, "save and load, without pickle", "KeyError: 'W'"),
    (SavesWithPickle, "save and load, without pickle", "allow_pickle=False"),
    (RestoresTwiceAsMuch, "restore can be repeated", "after a second restore"),
    (CountsInInt32, "State and Info have their shapes and types", "flags is int32"),
    (WritesIntoItsState, "step is pure", "changed the state"),
    (RemembersOutsideItsState, "step is pure", "something else later"),
    (ReusesItsBuffers, "step is pure", "had returned"),
    (AveragesOverMachines, "a batch gives what single runs give", "largest deviation"),
    (AveragesOverMachines, "machines do not touch each other", "moved another by"),
    (LooksAhead, "the future does not reach the past", "mean changed at tick 0"),
    (LooksTooFar, "a delay looks no further", "readings more than 10 s later change what is known"),
    (AnswersInTheTypeOfTheReadings, "readings may come as float32", "mean is float32"),
    (DiesOnNaN, "survives missing channels", "mean is not finite"),
    (NeverForgivesAGap, "survives missing channels", "error afterwards"),
    (WaitsForTheFirstReading, "survives a beginning without readings", "not finite from 0.00 s"),
    (NeverForgivesASpike, "survives spikes", "error afterwards"),
    (NeverForgivesAStuckSensor, "survives a stuck channel", "error afterwards"),
    (LeavesTheBounds, "health stays in its physical bounds, whatever is read", "outside"),
    (Skewed, "the covariance is symmetric and positive semidefinite", "asymmetric by"),
    (Indefinite, "the covariance is symmetric and positive semidefinite", "below zero by"),
    (TurnsIntervalsAround, "intervals are ordered and have width", "low <= mean <= high"),
    (NeverInDoubt, "intervals are ordered and have width", "no width"),
    (DoublesNIS, "innovations are NaN where missing, and NIS follows from them", "NIS off by"),
    (MakesUpInnovations, "innovations are NaN where missing, and NIS follows from them", "without a reading"),
    (TellsNoGaps, "flags tell missing and spiked channels", "wrong FLAG_MISSING"),
    (TellsNoSpikes, "flags tell missing and spiked channels", "without FLAG_SPIKE"),
    (StaysYoung, "ages grow while a channel is missing", "growth per tick"),
    (ForecastsInFloat32, "a forecast has its shape and is finite", "float32"),
    (ForecastsNaN, "a forecast has its shape and is finite", "not finite within 400"),
    (AdvancesByForecasting, "a forecast leaves the state as it was", "changed the state"),
    (ReadsAllInputsAtOnce, "a forecast does not look at later inputs", "change earlier ticks"),
    (DiffersWhenWrittenOut, "its implementations agree", "differ"),
    (FiltersWithoutProcessNoise, "on a linear-Gaussian toy it is the textbook Kalman filter", "relative deviation"),
]


@pytest.mark.parametrize(("kind", "promise", "said"), CAUGHT, ids=[kind.__name__ for kind, _, _ in CAUGHT])
def test_who_breaks_a_promise_is_caught_by_it(kind, promise, said):
    result = judge(promise, Subject(kind))
    assert result.status == "fail"
    assert said in result.detail
    assert "\n" not in result.detail


def test_every_promise_has_somebody_who_breaks_it():
    assert {promise for _, promise, _ in CAUGHT} == set(PROMISES)


def test_an_exception_fails_its_promise_and_the_rest_go_on():
    class Explodes(Good):
        def forecast(self, state, inputs):
            raise RuntimeError("no\nforecast")

    results = {r.name: r for r in run_battery(Explodes)}
    assert results["a forecast has its shape and is finite"] == (
        "a forecast has its shape and is finite",
        "fail",
        "RuntimeError: no",
    )
    assert results["step is pure"].status == "pass"
