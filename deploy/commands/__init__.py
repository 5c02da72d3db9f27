"""The command line: one file per family of commands.

The highest room: it may import all others, each when a command is called. Start with `app.py`, the table of
commands.
"""
