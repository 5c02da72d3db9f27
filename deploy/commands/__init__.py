"""The command line: one file a family of commands.

The highest room: it may import all others, each when a command is called. Begin with `main.py`, the table of
commands.
"""
