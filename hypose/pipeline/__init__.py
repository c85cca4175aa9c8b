"""Process one recording from start to end; used by the command line, the benchmarks and users of `import hypose`."""
