"""Promises about Info: innovations, flags, ages. An estimator may have none."""

from __future__ import annotations

import numpy as np

from twinbench.bench.contract.outcome import NotOffered, at_most, need
from twinbench.bench.contract.promise import promise
from twinbench.bench.contract.subject import Subject, Trace
from twinbench.methods.estimator import FLAG_MISSING, FLAG_SPIKE


def _offered(s: Subject, part: str, says: str) -> list[Trace]:
    """The traces under which diagnostics are tried, if there are any at all."""
    traces = [s.trace(name) for name in ("undisturbed", "missing", "spiked")]
    if np.isnan(getattr(traces[0], part)).all():
        raise NotOffered(f"Info holds no {says}")
    return traces


@promise("innovations are NaN where missing, and NIS follows from them")
def _innovations(s: Subject) -> str:
    compared, worst = 0, 0.0
    traces = _offered(s, "innovation", "innovations")
    for trace, name in zip(traces, ("undisturbed", "missing", "spiked"), strict=True):
        gone = np.isnan(s.recordings[name].swapaxes(0, 1)[..., len(s.machine.inputs) :])
        need(np.isnan(trace.innovation[gone]).all(), f"an innovation without a reading ({name})")
        need(not (trace.accepted & gone).any(), f"a channel without a reading is accepted ({name})")
        need(np.isfinite(trace.innovation[trace.accepted]).all(), f"an accepted channel has no innovation ({name})")
        need(np.isnan(trace.nis[~trace.accepted.any(axis=-1)]).all(), f"NIS without an accepted channel ({name})")
        sd = np.sqrt(np.diagonal(trace.S, axis1=-2, axis2=-1))
        for pattern in np.unique(trace.accepted.reshape(-1, len(s.machine.outputs)), axis=0):
            channels = np.flatnonzero(pattern)
            # Beyond four deviations a method may clip, and say the NIS of what it used.
            calm = (np.abs(trace.innovation) < 4.0 * sd)[..., channels].all(axis=-1)
            rows = (trace.accepted == pattern).all(axis=-1) & calm
            if not len(channels) or not rows.any():
                continue
            r = trace.innovation[rows][:, channels]
            S = trace.S[rows][:, channels[:, None], channels]
            nis = np.einsum("ki,ki->k", r, np.linalg.solve(S, r[..., None])[..., 0])
            worst = max(worst, float((np.abs(trace.nis[rows] - nis) / np.maximum(nis, 1.0)).max()))
            compared += len(r)
    need(compared > 0, "no tick with an innovation below four standard deviations")
    return at_most(worst, 1e-6, f"over {compared} updates, NIS off by")


@promise("flags tell missing and spiked channels")
def _flags(s: Subject) -> str:
    seen = [s.trace(name) for name in ("missing", "spiked")]
    if not any(t.flags.any() or t.accepted.any() or np.isfinite(t.age_s).any() for t in seen):
        raise NotOffered("Info holds no diagnostics")
    trace = s.trace("missing")
    gone = np.isnan(s.recordings["missing"]).any(axis=-1).T
    told = (trace.flags & FLAG_MISSING).astype(bool)
    need((told == gone).all(), f"{(told != gone).sum()} of {gone.size} ticks with the wrong FLAG_MISSING")
    trace, count, rejected = s.trace("spiked"), 0, 0
    for tick, channel in s.ground.spikes():
        if channel < len(s.machine.inputs):
            continue
        out = ~trace.accepted[tick, :, channel - len(s.machine.inputs)]
        quiet = out & ~(trace.flags[tick] & FLAG_SPIKE).astype(bool)
        need(not quiet.any(), f"a spike in {s.machine.channels[channel]} is rejected at tick {tick} without FLAG_SPIKE")
        count, rejected = count + out.size, rejected + int(out.sum())
    return f"{gone.sum()} ticks with gaps told; of {count} spikes {rejected} rejected, all of those flagged"


@promise("ages grow while a channel is missing")
def _ages(s: Subject) -> str:
    _offered(s, "age_s", "ages")
    trace = s.trace("missing")
    gone = np.isnan(s.recordings["missing"].swapaxes(0, 1))
    need((trace.age_s >= 0.0).all(), "an age is NaN or negative")
    need((trace.age_s[gone] > 0.0).all(), "a missing channel has age 0")
    need((trace.age_s[..., len(s.machine.inputs) :][trace.accepted] == 0.0).all(), "an accepted channel has an age")
    before, after = trace.age_s[:-1][gone[1:]], trace.age_s[1:][gone[1:]]
    seen = np.isfinite(before)
    growth = np.abs(after[seen] - before[seen] - s.machine.sample_period_s)
    need(seen.any(), "ages are infinite throughout")
    return at_most(float(growth.max()), 1e-6, f"oldest {after[seen].max():.1f} s, growth per tick off by")
