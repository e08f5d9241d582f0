"""Which experiment would tell rivals apart: candidates within limits, and what each promises by expected evidence."""
