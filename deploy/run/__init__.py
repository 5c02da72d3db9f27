"""Execution of one run, from its plan to its results, and of many runs in parallel.

It builds on `dashboard` and `record`. Start with `exploration.py`, the entry point; `execution.py` runs a plan, and
`result.py` has the results. `launch.py` runs a plan as processes on Zenoh, `in_memory.py` in this process.
`processes.py` has the entry point of each process. `workers.py` executes many runs in parallel, on this machine or on a
cluster.
"""
