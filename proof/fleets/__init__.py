"""Judges what is said of a fleet: machines that share an effect, and a few that have a fault of their own."""
