"""What is told in one line."""


class BadInput(ValueError):
    """Something a user gave cannot be used: says what, where and how to mend it, in one line."""


class WorkerKilled(RuntimeError):
    """A worker ended in mid-work: killed, out of memory, or a crash in compiled code."""
