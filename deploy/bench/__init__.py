"""Benchmarks (`murmur bench`): each value as a ratio to a baseline measured in the same run.

This package builds on `run` and is independent of `after` and `study`. `registry.py` lists the benchmarks; each yields
values of `measurement.py`. Only ratios are comparable between machines, so tests never assert absolute times.
"""
