"""The decision learnt: cases with known truth are drawn by the thousand, and what speaks for right names is weighed."""
