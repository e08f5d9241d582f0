"""A profile as small as a run can be."""

PROFILE = """# As small as a run can be.
seeds = [0]
scenes = false

[data]
n_train = 2
n_validation = 1
n_calibration = 1
n_test = 2
n_single = 1
minutes = 2.5
warmup_minutes = 0.5

[evaluation]
origin_every_s = 20.0

[latency]
updates = 0
"""
