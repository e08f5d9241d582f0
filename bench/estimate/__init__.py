"""A trained estimator on a user's recordings, and whether its answer is usable."""
