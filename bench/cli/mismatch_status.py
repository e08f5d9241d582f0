"""The exit status of ``twinbench mismatch``, by verdict. What every command shares (1, 2, 3, 130) is not among them."""

AGREES, NAMED, UNNAMED = 0, 10, 11
STATUS = {
    "consistent": AGREES,
    "parameter change": AGREES,
    "sensor fault": NAMED,
    "missing physics": NAMED,
    "incomplete": UNNAMED,
    "unexplained": UNNAMED,
}
SAYS = {
    AGREES: "the simulator agrees with the recordings, as it came or with other parameters",
    NAMED: "missing physics, or a fault of a sensor or an input, is named",
    UNNAMED: "something is wrong, and it has no name or is not named in full",
}
"""What each status means, for help and docs."""
