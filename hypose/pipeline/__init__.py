"""Pipeline: one recording from start to end, for the command line, the benchmarks and people who import hypose."""
