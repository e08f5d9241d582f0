"""How estimators and quantities are ordered and called in every table, figure and report."""

from __future__ import annotations

from collections.abc import Iterable

REFERENCE = "oracle"
"""The estimator that knows the exact plant, the sensors and in what ways health moves: what all are measured against.
It is no bound: it is linearised, and does not know that a ramp is straight."""
HINDSIGHT = "oracle_smoother"
"""The same, looking back from the end of a recording: what could be known afterwards, and by nobody at the time."""
PRIOR = "always_prior"
"""What looks at no measurement: an estimator that is no better has learnt nothing worth having from its sensors."""
TRIVIAL = (PRIOR, "training_mean", "last_value")
"""Rows that cost nothing: an estimator is worth what it errs less than the best of them."""
TRUE_START = "true_start_held"
"""A row that cannot be had: each machine's true health at minute 0, held. It is no estimator: scoring makes it."""
UNRANKED = (REFERENCE, HINDSIGHT, *TRIVIAL, TRUE_START)
"""Shown in every table, ranked in none, and never marked as the best."""
PROPOSED = "deeponet_kalman"
WITHOUT_EQUATIONS = ("gru_kf", "s5_kf", "lstm_rls", "deeponet", "pinn_ukf", PROPOSED)
"""Those that learn a machine from recordings and re-simulations, and carry no equations of it."""
WEIGHS_STEPS = (REFERENCE, HINDSIGHT, "nominal_imm", PROPOSED)
"""Those that weigh what may have leapt or failed when the readings step."""

LABELS = {
    "oracle": "Oracle (reference)",
    "oracle_smoother": "Oracle with hindsight",
    "always_prior": "Always at the prior",
    "training_mean": "Mean of training",
    "last_value": "Last value held",
    "true_start_held": "True start held",
    "nominal_ekf": "Nominal EKF",
    "nominal_ekf_mended": "Nominal EKF, mended",
    "nominal_ukf": "Nominal UKF",
    "nominal_iekf": "Nominal iterated EKF",
    "nominal_enkf": "Nominal EnKF",
    "nominal_pf": "Nominal particle filter",
    "nominal_imm": "Nominal IMM",
    "nominal_mhe": "Nominal MHE",
    "residual_ukf": "Residual UKF",
    "recursive_kalmannet": "Recursive KalmanNet",
    "gru_kf": "GRU + KF",
    "s5_kf": "S5 + KF",
    "lstm_rls": "LSTM + RLS",
    "deeponet": "DeepONet",
    "pinn_ukf": "PINN + UKF",
    "deeponet_kalman": "DeepONet-Kalman",
}
"""Printed name of each estimator of the benchmark, in the one order that is used throughout."""

PEERS = {
    "filterpy_ekf": "filterpy's EKF",
    "filterpy_ukf": "filterpy's UKF",
    "numba_ekf": "EKF",
    "numba_ukf": "UKF",
    "operator": "Operator",
}
"""What latency shows beside the estimators."""

QUANTITIES = {
    "p_int_bar": ("intake pressure", "bar"),
    "p_exh_bar": ("exhaust pressure", "bar"),
    "T_gas_K": ("gas temperature", "K"),
    "T_wall_K": ("wall temperature", "K"),
    "flow_memory": ("flow memory", "1"),
    "capacity": ("capacity", "1"),
    "efficiency": ("efficiency", "1"),
    "leakage": ("leakage", "1"),
    "heat_transfer": ("heat transfer", "1"),
    "T_bias_K": ("temperature bias", "K"),
}
"""Printed name and unit of each of the ten estimated quantities."""

ABLATION = ":"
"""What stands between an estimator's name and that of an ablation of it."""


def is_ablation(name: str) -> bool:
    """Is it an estimator without one of its parts?"""
    return ABLATION in name


def ordered(names: Iterable[str]) -> list[str]:
    """The benchmark's estimators in their order, then any others by name."""
    present = set(names)
    return [n for n in LABELS if n in present] + sorted(present - set(LABELS))


def label(name: str) -> str:
    """How an estimator is printed; one that the benchmark does not know keeps its name."""
    return LABELS.get(name) or PEERS.get(name, name)
