"""What a variable is, told by its unit and its name."""

from __future__ import annotations

import re
from typing import NamedTuple


class Thermometer(NamedTuple):
    """A unit of temperature: in it a cold, a hot and a common ambient; kelvin are ``per_unit * value + zero_K``."""

    cold: float
    hot: float
    common: float
    per_unit: float
    zero_K: float


_KELVIN = Thermometer(240.0, 325.0, 295.0, 1.0, 0.0)
_CELSIUS = Thermometer(-30.0, 50.0, 20.0, 1.0, 273.15)
TEMPERATURES = {
    "K": _KELVIN,
    "kelvin": _KELVIN,
    "degC": _CELSIUS,
    "°C": _CELSIUS,
    "celsius": _CELSIUS,
    "degF": Thermometer(-20.0, 120.0, 70.0, 5.0 / 9.0, 459.67 * 5.0 / 9.0),
}
"""Units of temperature."""
AMBIENT = re.compile(r"(?<![a-z])t?amb(ient)?(?![a-z])")
"""Names of an ambient temperature: T_amb_K, Tamb, ambient; not T_chamber_K."""
SPEEDS = {"rpm", "r/min", "1/min", "Hz", "rad/s", "rad/min", "deg/s", "m/s", "cm/s", "mm/s", "km/h"}
"""Units of states that move: friction holds them back even if they never turn round."""
CONTENTS = {"m", "cm", "mm", "m3", "m^3", "l", "L", "kg", "V", "%"}
"""Units of the content of a vessel, which can spill into the next."""
PRESSURES = {"Pa", "kPa", "MPa", "mbar", "bar", "psi", "bara", "psia"}
"""Units of absolute pressures: of gauge pressures no ratio says anything."""
MASS_FLOWS = {"kg/s", "g/s", "kg/h", "kg/min", "t/h", "lb/s", "lb/h"}
"""Units of mass flows."""
