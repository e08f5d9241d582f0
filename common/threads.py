"""One thread per process, everywhere: two single-threaded processes beat two threads in one."""

from __future__ import annotations

import os

_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)


def pin() -> None:
    """Pin BLAS, OpenMP, numba and torch to one thread. Call before NumPy is first imported."""
    for name in _VARIABLES:
        os.environ.setdefault(name, "1")


def pin_loaded() -> None:
    """The same for libraries that came before ``pin``: whoever runs this process had them loaded."""
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)


def pin_torch() -> None:
    """The same for torch once it may be imported; deterministic algorithms as well."""
    import torch

    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(True)
