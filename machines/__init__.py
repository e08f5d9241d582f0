"""Machines: what the benchmark needs to know of one, and the ones that it knows."""
