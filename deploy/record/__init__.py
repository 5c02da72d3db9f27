"""What a run leaves: records as they come in, the summary, the run directory, pictures of maps.

It stands on `scenario`. Begin with `records.py`, what the laboratory hears; `summary.py` makes figures and the
digest of it, `run_directory.py` writes it all.
"""
