"""What judges the mismatch engine: concealed effects, the flagship question, opponents, real recordings."""
