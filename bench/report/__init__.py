"""What a run says: tables, figures, sentences, one page."""
