"""Lumped machines of any domain as plain data, and their twins. The engine's own process may import this."""
