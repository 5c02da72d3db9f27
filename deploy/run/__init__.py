"""One run, from its plan to its results.

It stands on `dashboard` and `record`. Begin with `exploration.py`; `launch.py` runs a plan as processes on Zenoh,
`in_memory.py` in this one; `processes.py` is what each process does, `repeat.py` a finished run made anew.
"""
