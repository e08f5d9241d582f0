"""Scores, their bootstrap, ranks, pairs and coverage."""
