"""Bad input, told in one line."""


class BadInput(ValueError):
    """Something a user gave cannot be used: says what, where and how to mend it, in one line."""
