"""Everything derived from a finished run: figures, reports, films, listings of captures, and exports.

It builds on `run`, independent of `study` and `bench`. Start with `archive.py`, which reads a run directory. `merge.py`
makes such a directory from the records of robots in the field.
"""
