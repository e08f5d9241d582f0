"""Naming by evidence: which effects of a catalogue the recordings speak for, and how sure that is."""
