"""Other ways to say what a simulator leaves out, called as ``mismatch.diagnose``, for comparison in the suite.

They stand outside ``bench.prove``, which the blind process that runs them can neither import nor read.
"""
