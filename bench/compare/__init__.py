"""Which estimator foretells a user's own recordings best, where nobody knows the truth?"""
