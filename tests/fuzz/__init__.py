"""Mutated input for every command that reads files, and what each command made of it.

``python tests/fuzz`` runs all of it and writes ``results/fuzz``; ``python tests/fuzz estimate 17`` runs one
case, says what happened and leaves its folder. A case is made from its command, the seed and its number alone.
"""
