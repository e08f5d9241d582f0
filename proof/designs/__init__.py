"""Does the proposed experiment settle a verdict that is a set? Concealed machines on which it is made."""
