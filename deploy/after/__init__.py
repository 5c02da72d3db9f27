"""Everything derived from a finished run: figures, a report, a listing of its capture, exports.

It builds on `run`, independent of `study` and `bench`. Start with `archive.py`, which reads a run directory.
"""
