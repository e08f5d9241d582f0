"""Names for places: equations hold whatever stands where in the lists of variables."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twinbench.machines.compressor import CHANNEL, CHANNELS, ESTIMATE, ESTIMATED, STATE
from twinbench.machines.compressor import STATES as ESTIMATED_STATES
from twinbench.physics import compressor
from twinbench.physics.compressor import FLUXES, INPUTS, OUTPUTS, PARAMETERS, PLANT, STATES, F, P, U, X, Y
from twinbench.physics.fingerprint import Untold, fingerprint
from twinbench.physics.integrate import simulate
from twinbench.physics.places import places
from twinbench.physics.simulator import Simulator


@pytest.mark.parametrize(
    ("record", "names"),
    [
        *[(r, [v.name for v in g]) for r, g in ((P, PARAMETERS), (X, STATES), (U, INPUTS), (Y, OUTPUTS), (F, FLUXES))],
        (STATE, ESTIMATED_STATES),
        (CHANNEL, CHANNELS),
        (ESTIMATE, ESTIMATED),
    ],
)
def test_every_name_says_where_it_stands(record: Any, names: list[str]) -> None:
    assert record._asdict() == {name: i for i, name in enumerate(names)}


def test_what_is_estimated_stands_first_in_the_plant() -> None:
    assert tuple(v.name for v in STATES[: len(ESTIMATED_STATES)]) == ESTIMATED_STATES
    assert tuple(v.name for v in INPUTS + OUTPUTS) == CHANNELS


def _with_a_parameter_more(folder: Path) -> Simulator:
    """The plant as its own source makes it with one more parameter in the middle of the list."""
    source = Path(str(compressor.__file__)).read_text()
    before = '    Variable("K_s", '
    assert source.count(before) == 1
    file = folder / "plant_with_a_parameter_more.py"
    file.write_text(source.replace(before, f'    Variable("dummy", "1", 0.0, 9.0, 7.0),\n{before}'))
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    made: Simulator = module.PLANT
    return made


def test_a_parameter_in_the_middle_shifts_nothing(tmp_path: Path) -> None:
    moved = _with_a_parameter_more(tmp_path)
    assert 0 < moved.index("dummy") < len(PARAMETERS)
    assert len(moved.parameters) == len(PARAMETERS) + 1
    rng = np.random.default_rng(3)
    nominal, scale = (np.array([getattr(v, field) for v in INPUTS]) for field in ("nominal", "scale"))
    inputs = nominal + 0.3 * scale * rng.normal(size=(2, 60, len(INPUTS)))
    drawn = {v.name: min(v.nominal + 0.2 * v.scale * rng.random(), v.high) for v in PARAMETERS}
    ends = []
    for plant in (PLANT, moved):
        theta = plant.with_values(**drawn).theta()
        x0 = plant.initial(inputs[0, 0], np.array([v.nominal for v in OUTPUTS]), theta)
        ends.append(simulate(plant, inputs, x0, theta))
    for before, after in zip(*ends, strict=True):
        assert np.isfinite(before).all()
        assert np.array_equal(before, after)


def _reader(record: Any) -> Any:
    names = {"P": record, "__name__": "twinbench.physics.compressor"}
    exec("def read(theta):\n    return theta[P.b]\n", names)
    return names["read"]


def test_machine_code_is_known_by_the_places_that_it_reads() -> None:
    first, second = (fingerprint(_reader(places(names))) for names in (("a", "b"), ("b", "a")))
    assert first != second
    assert first != fingerprint(_reader(places(("a", "b", "c"))))
    with pytest.raises(Untold):
        fingerprint(_reader(object()))
