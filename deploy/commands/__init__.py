"""The command line: one file per family of commands.

The top package: it may import all others, each when a command is called. Start with `app.py`, the table of commands.
`scenario_flags.py` derives flags from the settings of a scenario.
"""
