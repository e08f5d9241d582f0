"""Many machines of one kind: what is missing in all of them is the simulator's fault, what in one is that machine's."""
