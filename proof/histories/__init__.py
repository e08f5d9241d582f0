"""Judges what is said of a size over time: sizes that stay, grow or leap are hidden in simulated machines."""
