"""Exit codes of commands and processes (docs/architecture.md)."""

EXPLORED, NOT_FINISHED, BAD_INPUT, BROKEN_OFF = range(4)
INTERRUPTED = 130
"""Exit code after Ctrl-C, as that of a process that the signal ended."""
