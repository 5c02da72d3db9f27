"""Entry point of the `murmur` command. It imports almost nothing before it handles Ctrl-C."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
from types import FrameType

from deploy.run.exit_codes import INTERRUPTED

MESSAGE = b"murmur: interrupted\n"
"""What `deploy.commands.console.report_user_errors` prints at other times than during imports."""


def main() -> None:
    """Run the command line; once a command is over, a signal does not change its exit code any more."""
    _handle_signals()
    _open_closed_streams()
    _replace_unknown_characters()
    from deploy.commands.app import app  # noqa: PLC0415

    try:
        app()
    finally:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)


def _open_closed_streams() -> None:
    """Open the null device for standard streams that are closed (``>&-``): other files would get their numbers."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            null = open(os.devnull, "r+", encoding="utf-8")  # noqa: SIM115, PTH123  for the whole process
            os.set_inheritable(null.fileno(), True)
            setattr(sys, name, null)


def _handle_signals() -> None:
    """Let Ctrl-C and SIGTERM raise KeyboardInterrupt; during an import, let them end this process.

    Commands that must not lose data prevent the latter.
    """
    both = signal.SIGINT, signal.SIGTERM
    for number in both:
        signal.signal(number, _leave)
    from protocol.signals import is_importing  # noqa: PLC0415

    def interrupt(_: int, frame: FrameType | None) -> None:
        if is_importing(frame):
            _leave()
        raise KeyboardInterrupt

    for number in both:
        signal.signal(number, interrupt)


def _leave(*_: object) -> None:
    with contextlib.suppress(OSError):  # the terminal is gone
        os.write(2, MESSAGE)
    os._exit(INTERRUPTED)


def _replace_unknown_characters() -> None:
    """Print ``?`` for characters that the encoding of the output lacks, so that the results of a run are not lost."""
    if isinstance(sys.stdout, io.TextIOWrapper) and not sys.stdout.encoding.lower().startswith("utf"):
        sys.stdout.reconfigure(errors="replace")


if __name__ == "__main__":
    main()
