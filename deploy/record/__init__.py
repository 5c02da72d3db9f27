"""The results of a run: recorded reports, summary, run directory, pictures of maps.

This package builds on `scenario`. `records.py` receives the reports of a run; `summary.py` computes metrics and the
digest from them; `run_directory.py` writes all results.
"""
