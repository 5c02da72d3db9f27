"""One run, from its plan to its results; and who makes many.

It builds on `dashboard` and `record`. Start with `exploration.py`; `launch.py` runs a plan as processes on Zenoh,
`in_memory.py` in this process; `processes.py` is what each process does, `repeat.py` repeats a finished run.
`workers.py` makes many runs beside each other, here or on a cluster.
"""
