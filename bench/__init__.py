"""Registry, runner, scores, statistics, report and command line."""

import physics as _physics  # noqa: F401  settles where compiled code is kept
