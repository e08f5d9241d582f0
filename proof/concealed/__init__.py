"""The concealed-effect suite: draw a truth, seal it, let the engine look for it blindly, judge.

Nothing here is known to the engine: it runs in ``proof.blind``, which can neither import nor read this package.
"""
