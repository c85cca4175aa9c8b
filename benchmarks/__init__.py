"""What measures hypose: accuracy, speed, robustness. `python -m benchmarks NAME`, or `make bench ARGS=NAME`."""
