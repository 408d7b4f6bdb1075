"""What prints figures; `python -m benchmarks` runs all of it and writes out/bench.json."""
