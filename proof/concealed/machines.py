"""The concealed machines by name."""

from __future__ import annotations

from twinbench.proof.concealed.compressor import MACHINE as COMPRESSOR
from twinbench.proof.concealed.heat_exchanger import MACHINE as HEAT_EXCHANGER
from twinbench.proof.concealed.motor import MACHINE as MOTOR
from twinbench.proof.concealed.tanks import MACHINE as TANKS

MACHINES = {m.name: m for m in (COMPRESSOR, MOTOR, TANKS, HEAT_EXCHANGER)}
