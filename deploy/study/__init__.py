"""Many runs: one scenario over factors and seeds, tested, compared and judged.

It builds on `run`, independent of `after`, `chaos` and `bench`. Start with `experiment.py`; `runs.py` has its runs made
and keeps them in the table of `results.py`; `claims.py` judges them by `statistics.py`; `reproduction.py`,
`comparison.py` and `sizing.py` are what people ask for. `experiments/` holds those that are installed with the code.
"""
