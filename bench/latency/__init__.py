"""What one online update takes, beside peers in the same run."""
