"""Many runs: one scenario over factors and seeds, collected and tabulated.

It builds on `run`, independent of `after` and `bench`. Start with `experiment.py`; `runs.py` makes its runs,
`tables.py` its table, and `experiments/` holds those that are installed with the code.
"""
