"""The benchmark: profiles, cells, the runner, statistics, the contract, latency, reports, the command line."""
