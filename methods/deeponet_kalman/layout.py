"""Where the operator's numbers lie: records of its weights, of what it carries along a stream, and of its scratch."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from twinbench.machines.machine import Machine
from twinbench.methods.deeponet_kalman.records import one_record, record
from twinbench.methods.operator import KERNEL, SINUSOIDS, SLOW_TAU_S, head_of_state, slow_channels

REACH_1 = KERNEL * (KERNEL - 1) + 1  # columns of block 1 that one column of block 2 looks at


def pack(machine: Machine, state: Mapping[str, np.ndarray]) -> np.ndarray:
    """Weights (1,) of a compiled operator, from a state dict of ``Operator`` whose names start with ``net.``.

    Matrices are (out, in), float32; those of the heads are (in, out). What the operator knows beside its weights is
    there, too: the head of each state, its slow channels and their memory from tick to tick, what its trunk sees of a
    tick's time.

    Args:
        machine: whose operator.
        state: by name, weights of any shape, dimensionless.
    """
    layers = {
        "block_1": "branch.block_1",
        "block_2": "branch.block_2",
        "mix_2": "branch.mix_2",
        "gate_tanh": "branch.gate_tanh",
        "gate_sigmoid": "branch.gate_sigmoid",
        "project": "branch.project",
        "embedding": "trunk.embedding",
        "trunk_hidden": "trunk.hidden",
        "trunk_project": "trunk.project",
        "from_latent": "heads.from_latent",
    }
    parts = {}
    for ours, theirs in layers.items():
        parts[ours], parts[f"{ours}_bias"] = state[f"net.{theirs}.weight"], state[f"net.{theirs}.bias"]
    parts["score"] = state["net.branch.score.weight"][0]
    parts["position"] = state["net.branch.position"]
    parts["from_condition"] = state["net.heads.from_condition.weight"].T
    for ours, theirs in (
        ("hidden", "hidden_weight"),
        ("hidden_bias", "hidden_bias"),
        ("out", "out_weight"),
        ("out_bias", "out_bias"),
    ):
        parts[ours] = state[f"net.heads.{theirs}"]
    slow, period_s = slow_channels(machine), machine.sample_period_s
    phase = period_s * (np.pi / (2.0 * period_s)) * np.array(SINUSOIDS)
    parts["time"] = np.concatenate([[1.0], np.sin(phase), np.cos(phase)])
    known = {
        "head_of_state": head_of_state(machine),
        "slow_channel": slow,
        "slow_keep": np.tile(np.exp(-period_s / np.array(SLOW_TAU_S)), len(slow) // len(SLOW_TAU_S)),
    }
    types = {name: ("f4", part.shape) for name, part in parts.items()}
    kinds = {name: (f"{part.dtype.kind}8", part.shape) for name, part in known.items()}
    return one_record(record({**types, **kinds}), {**parts, **known})


def stream_type(weights: np.ndarray) -> np.dtype[np.void]:
    """What the operator carries from tick to tick of one machine.

    Args:
        weights: (1,) of ``pack``, a record of dimensionless weights.
    """
    width_1, width_2 = (weights[name].shape[1] for name in ("block_1_bias", "block_2_bias"))
    tokens, columns = weights["position"].shape[1], weights["block_1"].shape[2] // KERNEL
    channels = columns // 3  # values, first differences, masks
    return record(
        {
            "ticks": ("i8", (1,)),  # samples pushed so far
            "newest": ("i8", (2,)),  # rows of ``values`` and of ``tokens`` that are newest: both are rings
            "values": ("f4", (KERNEL**2 * tokens, channels)),  # standardised
            "columns": ("f4", (KERNEL, columns)),  # newest last
            "first": ("f4", (REACH_1, width_1)),  # newest last
            "tokens": ("f4", (KERNEL**2 * (tokens - 1) + 1, width_2)),  # the attention looks at every 16th
            "scores": ("f4", (KERNEL**2 * (tokens - 1) + 1,)),
            "slow": ("f8", weights["slow_keep"].shape[1:]),  # running means of the slow channels
            "base": ("f4", (weights["from_latent_bias"].shape[1],)),  # the heads' first layer, latent part
        }
    )


def scratch_type(weights: np.ndarray) -> np.dtype[np.void]:
    """Room for what is reckoned in between.

    Args:
        weights: (1,) of ``pack``, a record of dimensionless weights.
    """
    heads, _, width = weights["hidden"].shape[1:]
    states, condition = weights["out"].shape[1], weights["from_condition"].shape[1]
    wide = {name: weights[f"{name}_bias"].shape[1] for name in ("block_2", "gate_tanh", "embedding", "trunk_hidden")}
    return record(
        {
            "reached": ("f4", (weights["block_2"].shape[2],)),
            "second": ("f4", (wide["block_2"],)),
            "mixed": ("f4", (wide["block_2"],)),
            "gated": ("f4", (2, wide["gate_tanh"])),
            "weight": ("f4", (weights["position"].shape[1],)),
            "summary": ("f4", (weights["project"].shape[2],)),
            "latent": ("f4", (weights["project"].shape[1],)),
            "query": ("f4", (weights["trunk_hidden"].shape[2] - wide["embedding"] - weights["time"].shape[1],)),
            "embedded": ("f4", (wide["embedding"],)),
            "entry": ("f4", (weights["trunk_hidden"].shape[2],)),
            "trunk_hidden": ("f4", (wide["trunk_hidden"],)),
            "trunk": ("f4", (weights["project"].shape[1],)),
            "head": ("f4", (heads * width,)),
            "slope": ("f4", (heads * width,)),
            "second_slope": ("f4", (width,)),
            "rows": ("f4", (condition + 1, width)),
            "deep": ("f4", (heads, condition + 1, width)),
            "condition": ("f4", (condition,)),
            "moved": ("f4", (condition,)),
            "ahead": ("f4", (states,)),
            "out": ("f4", (states,)),  # scaled increments
            "jacobian": ("f4", (states, condition)),  # of these to state and zeta
        }
    )
