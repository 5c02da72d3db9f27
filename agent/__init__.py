"""A robot: its settings, its control logic, and its process.

It imports `protocol` only. Start with `robot.py`, one pass of the thesis' Algorithm 10. Its parts are packages:
`mapping` draws scans on a grid, `encodings` turn the grid into log entries (with `outline` and `predictive`),
`replication` copies logs to teammates, and `strategies` choose targets (with `planning`). `process.py` is the shell
around it in a simulation, `field.py` in the field, with `radios` and `bodies`.
"""
