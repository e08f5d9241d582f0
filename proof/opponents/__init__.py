"""Other ways to say what a simulator leaves out, called as ``mismatch.diagnose``, for comparison in the suite.

They stand outside ``proof.concealed``, which the blind process that runs them can neither import nor read.
"""
