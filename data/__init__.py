"""Recordings, scenarios, corruption and splits."""

import physics as _physics  # noqa: F401  settles where compiled code is kept
