"""Timings that back a claim, each with its peer measured in the same run."""
