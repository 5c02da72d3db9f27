"""Studies of many runs: a scenario over factors and seeds, with tests, comparisons and verdicts.

This package builds on `run` and is independent of `after`, `chaos` and `bench`. `experiment.py` reads an experiment;
`runs.py` makes its runs and keeps them in the table of `results.py`; `claims.py` judges them by `statistics.py`.
`sweep.py`, `comparison.py`, `sizing.py` and `reproduction.py` implement the commands. `experiments/` holds the shipped
experiments.
"""
