"""Scenarios and the plans derived from them: the input of a run.

The lowest package of `deploy`; it depends on robots, world and radio only for their settings. Start with
`scenario.py`, which joins five groups of settings, each in a file of its own; then `plan.py`. `shipped/` contains the
scenarios that are installed with the code.
"""
