"""The ``twinbench`` command: one file for each of its commands."""
