"""Page's test (Biometrika 41, 1954) for shifts of a filter's innovations, a quick sum and a slow one. Compiled.

Innovations of a filter that is right are white, of mean zero and known sd. A cumulative sum of them, less a slack,
stays low as long as that is so. The quick sum sees within a few updates what is several sd off. The slow one needs
longer and sees what is one sd off, as the readings are after a small step of health that the filter cannot follow.
"""

from __future__ import annotations

import numpy as np
from numba import njit

SLACK_SD = (1.0, 0.25)
"""What each innovation may be off for nothing, quick and slow sum. Twice as much is the shift that is seen soonest."""
LIMIT_SD = (7.0, 25.0)
"""What a sum must reach. Less finds smaller steps sooner, and more of them where nothing happened: white innovations
reach it once in a million updates and more."""
MOST_SD = (5.0, 3.0)
"""What one innovation counts at most, so that a single outlier is no shift."""
N_SUMS = len(SLACK_SD)


@njit(cache=True, error_model="numpy")
def shifted(sums, innovation, sd, c):  # type: ignore[no-untyped-def]
    """Did output ``c`` shift, either way? Takes one innovation in; an alarm begins all sums of the output anew.

    Args:
        sums: (2, 2, m) dimensionless, quick and slow, upwards and downwards, of each output; zero at first.
        innovation: of that output, in its unit, and not NaN.
        sd: of the innovation, in the same unit.
        c: which output.
    """
    alarm = False
    for k in range(N_SUMS):
        normal = min(max(innovation / sd, -MOST_SD[k]), MOST_SD[k])
        sums[k, 0, c] = max(0.0, sums[k, 0, c] + normal - SLACK_SD[k])
        sums[k, 1, c] = max(0.0, sums[k, 1, c] - normal - SLACK_SD[k])
        alarm = alarm or max(sums[k, 0, c], sums[k, 1, c]) >= LIMIT_SD[k]
    if alarm:
        forget(sums, c)
    return alarm


@njit(cache=True, error_model="numpy")
def forget(sums, c):  # type: ignore[no-untyped-def]
    """Begin all sums (2, 2, m) of output ``c`` anew, in place."""
    for k in range(N_SUMS):
        for side in range(2):
            sums[k, side, c] = 0.0


def no_shifts(outputs: int) -> np.ndarray:
    """Sums (2, 2, outputs) before the first innovation."""
    return np.zeros((N_SUMS, 2, outputs))
