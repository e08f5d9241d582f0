"""Exams that others set, each one file: loader, simulator, what the setter says is true, score."""
