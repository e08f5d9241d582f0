"""A trained DeepONet-Kalman as files for machines without this package."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np

from twinbench.bench import cells
from twinbench.bench.estimate.apply import Training, trained_cells
from twinbench.bench.registry import find
from twinbench.common.errors import BadInput
from twinbench.common.store import write_atomically
from twinbench.methods.deeponet_kalman.export import filter_arrays, operator_graph
from twinbench.methods.deeponet_kalman.method import DeepONetKalman


def export(name: str, out: Path, profile_name: str, results: Path | None) -> list[Path]:
    """Write ``operator.onnx`` and ``filter.npz`` of a trained estimator into ``out``.

    Args:
        results: the run it was trained in; None: where ``twinbench run`` puts it.

    Returns:
        The files' paths.

    Raises:
        BadInput: it is no DeepONet-Kalman or not trained there, onnx is not installed, or ``out`` cannot be written to.
    """
    if not issubclass(find(name), DeepONetKalman):
        raise BadInput(f"{name} cannot be exported, only {DeepONetKalman.name} can; leave --estimator out")
    if find_spec("onnx") is None:
        raise BadInput("export needs onnx; install it with: pip install 'twinbench[export]'")
    store, (cell,) = trained_cells(Training(profile_name, results), [name])
    estimator = cells.load_fit(store, cell)
    assert isinstance(estimator, DeepONetKalman)
    graph, arrays = operator_graph(estimator), filter_arrays(estimator)
    files = [out / "operator.onnx", out / "filter.npz"]
    write_atomically(files[0], lambda path: path.write_bytes(graph))
    write_atomically(files[1], lambda path: _save(path, arrays))
    return files


def _save(path: Path, arrays: dict[str, np.ndarray]) -> None:
    with open(path, "wb") as file:  # given a path, NumPy would add a suffix of its own
        np.savez(file, allow_pickle=False, **arrays)
