"""The estimator protocol, the operator network and DeepONet-Kalman."""

import physics as _physics  # noqa: F401  settles where compiled code is kept
