"""The engine with one guard left out at a time; ``mismatch.guards`` says what each is for."""

from __future__ import annotations

from functools import partial

from twinbench.mismatch import ablated
from twinbench.mismatch.guards import Guards

no_projection = partial(ablated, Guards(projection=False))
no_whitening = partial(ablated, Guards(whitening=False))
no_held_out_gate = partial(ablated, Guards(held_out_gate=False))
no_pairs = partial(ablated, Guards(pairs=False))
no_nominal_null = partial(ablated, Guards(nominal_null=False))
