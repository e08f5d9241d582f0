"""A simulator, mended or not, back to where models live: as an FMU."""

from __future__ import annotations

from pathlib import Path

from twinbench.common.errors import BadInput
from twinbench.mismatch.model import as_bad_input, load_model
from twinbench.physics.fmu.write import write_fmu


def write_as_fmu(spec: str, file: Path, trust: bool = False) -> None:
    """Write the simulator of a spec into an ``.fmu`` file.

    Args:
        trust: run the Python that a ``model.toml`` names wherever it lies.

    Raises:
        BadInput: the simulator cannot be used, or is one that no FMU can hold; nothing is written.
    """
    if file.suffix != ".fmu":
        raise BadInput(f"--out {file}: an FMU's name ends in .fmu; call it {file.with_suffix('.fmu').name}")
    model = load_model(spec, trust)
    if model.faults:
        names = ", ".join(fault.name for fault in model.faults)
        raise BadInput(
            f"{spec}: holds {names}, made for whole recordings, which no FMU has; remove it there, with its values, "
            "to write the machine alone"
        )
    with as_bad_input():
        write_fmu(model.simulator, file)
