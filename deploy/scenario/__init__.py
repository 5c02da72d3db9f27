"""What is to be run: a scenario, checked, and the plan that it is worked out to.

The lowest room of `deploy`: it knows robots, world and radio by their settings. Begin with `scenario.py`, then
`plan.py`; `shipped/` holds scenarios that are installed with the code.
"""
