"""The concealed machines by name."""

from __future__ import annotations

from bench.prove.compressor import MACHINE as COMPRESSOR
from bench.prove.motor import MACHINE as MOTOR
from bench.prove.tanks import MACHINE as TANKS

MACHINES = {m.name: m for m in (COMPRESSOR, MOTOR, TANKS)}
