"""How large a named effect was over time: constant, growing, leaping or wandering, by the same evidence."""
