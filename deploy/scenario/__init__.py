"""What to run: a scenario, checked, and the plan derived from it.

The lowest room of `deploy`: it knows robots, world and radio by their settings. Start with `scenario.py`, then
`plan.py`; `shipped/` holds scenarios that are installed with the code.
"""
