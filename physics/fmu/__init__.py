"""Functional Mock-up Units as simulators."""
