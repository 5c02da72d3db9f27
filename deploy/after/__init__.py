"""What is made of a finished run: figures, a report, a listing of its capture, exports.

It stands on `run`, beside `study` and `bench`. Begin with `archive.py`, a run directory read back.
"""
