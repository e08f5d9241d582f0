"""The engine with one guard left out at a time; ``mismatch.guards`` says what each is for."""

from __future__ import annotations

from functools import partial

from twinbench.mismatch import diagnose
from twinbench.mismatch.guards import Guards

no_projection = partial(diagnose, guards=Guards(projection=False))
no_whitening = partial(diagnose, guards=Guards(whitening=False))
no_held_out_gate = partial(diagnose, guards=Guards(held_out_gate=False))
no_pairs = partial(diagnose, guards=Guards(pairs=False))
no_nominal_null = partial(diagnose, guards=Guards(nominal_null=False))
