"""Recordings, scenarios, corruption and splits."""
