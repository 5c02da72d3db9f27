"""Keyboard control of a run, from the terminal that started it."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import threading
from collections.abc import Callable, Iterator

from deploy.run.control import Control
from deploy.run.live_commands import LiveCommands

HELP = "space pause, s step, + - speed, k kill, b bandwidth, r range"
ASKING = {"k": ("kill robot", "kill"), "b": ("bandwidth", "bandwidth"), "r": ("range", "range")}
"""Keys that ask for a value, which ends with Enter: the question, and the command."""
PAUSED = "paused: space continues, s steps"


class Keys:
    """Translates key presses into control of a run."""

    def __init__(self, control: Control) -> None:
        self.message = HELP
        """The line to show: the input so far, a confirmation, an error, or the list of keys."""
        self._control = control
        self._commands = LiveCommands(control)
        self._asked = ""
        self._typed = ""

    def press(self, key: str) -> None:
        """Handle a key press."""
        if self._asked:
            self._type(key)
        elif key == " ":
            self._commands.perform("resume" if self._control.paused else "pause")
            self.message = PAUSED if self._control.paused else HELP
        elif key == "s":
            self._commands.perform("step")
            self.message = PAUSED
        elif key in "+-":
            self.message = self._commands.perform("faster" if key == "+" else "slower")
        elif key in ASKING:
            self._asked, self._typed = key, ""
            self.message = f"{ASKING[key][0]}: "

    def _type(self, key: str) -> None:
        if key in "\r\n":
            asked, self._asked = self._asked, ""
            self.message = self._do(asked, self._typed.strip())
        elif key == "\x1b":
            self._asked, self.message = "", HELP
        else:
            self._typed = self._typed[:-1] if key in "\x7f\b" else self._typed + key
            self.message = f"{ASKING[self._asked][0]}: {self._typed}"

    def _do(self, asked: str, value: str) -> str:
        try:
            return self._commands.perform(ASKING[asked][1], value)
        except ValueError as error:
            return str(error)


@contextlib.contextmanager
def controlled(control: Control | None) -> Iterator[Callable[[], str]]:
    """Read keys within the block; yields a function that returns the line to show below the progress."""
    if control is None:
        yield lambda: ""
        return
    import termios  # noqa: PLC0415  only terminals have it
    import tty  # noqa: PLC0415

    keys, stdin = Keys(control), sys.stdin.fileno()
    before = termios.tcgetattr(stdin)
    over_in, over = os.pipe()

    def read() -> None:
        while True:
            ready, _, _ = select.select([stdin, over_in], [], [])
            pressed = os.read(stdin, 64) if over_in not in ready else b""
            if not pressed:
                return
            for key in pressed.decode(errors="ignore"):
                keys.press(key)

    reader = threading.Thread(target=read, daemon=True)
    tty.setcbreak(stdin)
    reader.start()
    try:
        yield lambda: keys.message
    finally:
        os.write(over, b".")
        reader.join()
        os.close(over)
        os.close(over_in)
        with contextlib.suppress(termios.error):  # the terminal may be gone
            termios.tcsetattr(stdin, termios.TCSADRAIN, before)


def at_terminal() -> bool:
    """Whether keys can be read and messages shown."""
    return sys.stdin.isatty() and sys.stderr.isatty() and os.name == "posix"
