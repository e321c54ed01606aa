"""Benchmarks: ratios measured in one run beside other programs."""
