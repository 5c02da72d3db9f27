"""The results of a run: records as they come in, the summary, the run directory, pictures of maps.

It builds on `scenario`. Start with `records.py`, what the laboratory receives; `summary.py` computes figures and the
digest from it, `run_directory.py` writes everything.
"""
