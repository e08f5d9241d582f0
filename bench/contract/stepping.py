"""Promises about one step and about the batch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twinbench.bench.contract.outcome import NotOffered, at_most, need
from twinbench.bench.contract.promise import promise
from twinbench.bench.contract.subject import (
    FLOAT32,
    FLOAT32_ROUND_OFF,
    FLOAT64_ROUND_OFF,
    SHORT_RUN,
    SUBJECT_SEED,
    Subject,
    Trace,
    begun,
    record,
    same,
    snapshot,
)
from twinbench.bench.evaluate import run
from twinbench.bench.profile import Evaluation
from twinbench.methods.estimator import Info, State


def _shaped(s: Subject, said: State | Info, batch: int) -> None:
    n, ny, channels = len(s.machine.quantities), len(s.machine.outputs), len(s.machine.channels)
    shapes: dict[str, tuple[tuple[int, ...], type[np.generic]]] = {
        "mean": ((n,), np.float64), "cov": ((n, n), np.float64), "low": ((n,), np.float64), "high": ((n,), np.float64),
        "innovation": ((ny,), np.float64), "S": ((ny, ny), np.float64), "nis": ((), np.float64),
        "accepted": ((ny,), np.bool_), "flags": ((), np.int64), "age_s": ((channels,), np.float64),
    }  # fmt: skip
    for name, array in said._asdict().items():
        if name == "memory":
            for i, part in enumerate(array):
                plain = isinstance(part, np.ndarray) and part.dtype != object
                need(plain and part.shape[:1] == (batch,), f"memory[{i}] is no array that leads with the machines")
            continue
        shape, dtype = (batch, *shapes[name][0]), np.dtype(shapes[name][1])
        need(isinstance(array, np.ndarray), f"{name} is no NumPy array")
        fits = array.shape == shape and array.dtype == dtype
        need(fits, f"{name} is {array.dtype} {array.shape}, must be {dtype} {shape}")


@promise("State and Info have their shapes and types")
def _shapes(s: Subject) -> str:
    for batch in (1, 2, 3):
        state = s.fitted.init(batch)
        _shaped(s, state, batch)
        measured = np.repeat(s.recordings["undisturbed"][:1], batch, axis=0)
        for k in range(3):
            state, info = s.fitted.step(state, s.ground.sample_at(measured, k))
            _shaped(s, state, batch)
            _shaped(s, info, batch)
    return "for 1, 2 and 3 machines"


@promise("step is pure")
def _step_is_pure(s: Subject) -> str:
    measured = s.recordings["late"]
    tried = (0, 1, 39, 40, 41, 63, 64, 65, 200, 399)
    state = begun(s.fitted, 2)
    for k in range(measured.shape[1]):
        if k not in tried:
            state, _ = s.fitted.step(state, s.ground.sample_at(measured, k))
            continue
        sample, other = s.ground.sample_at(measured, k), s.ground.sample_at(measured, (k + 200) % SHORT_RUN)
        given = snapshot((state, sample))
        after = s.fitted.step(state, sample)
        kept = snapshot(after)
        need(same((state, sample), given), f"step changed the state or the sample it was given (tick {k})")
        s.fitted.step(after[0], other)
        need(same(after, kept), f"the next step changed what this one had returned (tick {k})")
        need(same(s.fitted.step(state, sample), kept), f"the same step gave something else later (tick {k})")
        state = after[0]
    return f"tried at {len(tried)} ticks, missing readings among them"


@promise("a batch gives what single runs give")
def _batch_equals_loop(s: Subject) -> str:
    measured = s.recordings["missing"][:, 300 : 300 + SHORT_RUN]
    together = record(s.fitted, measured)
    alone = [record(s.fitted, measured[b : b + 1]) for b in range(2)]
    single = Trace(*(np.concatenate(parts, axis=1) for parts in zip(*alone, strict=True)))
    return at_most(s.deviation(together, single), FLOAT32_ROUND_OFF, "largest deviation in typical changes")


@promise("machines do not touch each other")
def _independent(s: Subject) -> str:
    calm, wild = s.recordings["undisturbed"][:, :SHORT_RUN].copy(), s.recordings["absurd"]
    mixed = calm.copy()
    mixed[0] = wild[0]
    a, b = record(s.fitted, calm), record(s.fitted, mixed)
    second = [Trace(*(part[:, 1] for part in trace)) for trace in (a, b)]
    return at_most(s.deviation(*second), FLOAT64_ROUND_OFF, "absurd readings of one machine moved another by")


@promise("the future does not reach the past")
def _causal(s: Subject) -> str:
    batch = s.ground.benchmark.test.without_truth().select([0, 1], slice(0, 2 * SHORT_RUN))
    cut, period_s = 520, s.machine.sample_period_s
    ahead_s = 20 * period_s
    other = batch.measured.copy()
    other[:, cut:] = other[::-1, : other.shape[1] - cut] * 1.05
    other[:, cut + 50 : cut + 60] = np.nan
    evaluation = Evaluation(stride=1, origin_every_s=40 * period_s, leads_s=(ahead_s,))
    a, b = (run(s.fitted, b, evaluation, SUBJECT_SEED) for b in (batch, replace(batch, measured=other)))
    past = a.forecast_time_s + ahead_s < cut * period_s
    estimates = () if s.kind.two_sided else ("mean", "low", "high")  # these look back, and say so
    for name in (*estimates, "nis", "nis_dof", "flags"):
        changed = [
            not same(x, y)
            for x, y in zip(
                getattr(a, name)[:, :cut].swapaxes(0, 1), getattr(b, name)[:, :cut].swapaxes(0, 1), strict=True
            )
        ]
        need(not any(changed), f"{name} changed at tick {np.argmax(changed)}, the readings only from tick {cut} on")
    need(same(a.forecast[:, past], b.forecast[:, past]), "a forecast changed before the readings did")
    return f"{cut} ticks and {past.sum()} forecasts equal bit for bit under another future"


@promise("a delay looks no further")
def _delay(s: Subject) -> str:
    if not s.kind.delayed:
        raise NotOffered("it does not say what it knows later")
    measured, tick, delay = s.recordings["undisturbed"][:, :SHORT_RUN], SHORT_RUN // 4, SHORT_RUN // 2
    other, at, delay_s = measured.copy(), np.array([tick]), delay * s.machine.sample_period_s
    other[:, tick + delay + 1 :] = 1.05 * other[::-1, tick + delay + 1 :]
    known, blind = (s.fitted.smooth(part, at, delay_s) for part in (measured, other))
    need(same(known, blind), f"readings more than {delay_s:g} s later change what is known")
    at_once, filtered = s.fitted.smooth(measured, at, 0.0), record(s.fitted, measured[:, : tick + 1])
    for name in ("mean", "low", "high", "cov"):
        need(same(getattr(at_once, name), getattr(filtered, name)[-1]), f"without a delay {name} is not that of step")
    return f"{delay_s:g} s later under another future, and at once, equal bit for bit"


@promise("readings may come as float32")
def _float32(s: Subject) -> str:
    rounded = s.recordings["undisturbed"][:, :SHORT_RUN].astype(np.float32)
    narrow = record(s.fitted, rounded)  # type: ignore[arg-type]
    for name in ("mean", "low", "high", "cov"):
        need(getattr(narrow, name).dtype == np.float64, f"{name} is {getattr(narrow, name).dtype}, must be float64")
    return at_most(s.deviation(narrow, record(s.fitted, rounded.astype(np.float64))), FLOAT32, "largest deviation")
