"""The live dashboard: a viewer on the bus, its drawing, and the windows that show it (docs/dashboard.md).

It builds on `record`. Start with `process.py`, the viewer; `run_events.py` follows the run, `recorder.py` draws
it for Rerun.
"""
