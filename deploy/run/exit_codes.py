"""Exit codes of commands and processes (docs/architecture.md)."""

EXPLORED, NOT_FINISHED, BAD_INPUT, BROKEN_OFF = range(4)
