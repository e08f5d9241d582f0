"""Where every draw of the engine begins."""

ENGINE_SEED = 0
"""Always the same: the same recordings give the same verdict. ``verdict.json`` states it."""
