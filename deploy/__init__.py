"""Runs: describing them, starting their processes, recording, viewing and evaluating them.

Packages, each of which imports only those before it: `scenario`, `record`, `dashboard`, `run`; then `after`, `study`,
`chaos` and `bench`, which are independent of each other; then `commands`. Start with `run/exploration.py`, which takes
one run from its scenario to its directory. The Python API is the package `murmur`.
"""
