"""What a diagnosis says: words for the terminal, tables, figures, one page."""
