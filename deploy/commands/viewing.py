"""How a command shows its run: in a window or on a page, to whom, from when, and until when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from deploy.commands.console import errors

if TYPE_CHECKING:
    from deploy.dashboard.windows import Window
    from deploy.run.control import Control
    from deploy.run.live_commands import LiveCommands


@dataclass(frozen=True)
class Viewing:
    """How a run is shown."""

    mode: str | None = None
    """One of `deploy.dashboard.windows.MODES`; None: not at all."""
    share: bool = False
    """Whether the page is served on the local network."""
    wait: bool = False
    """Whether the run waits for a viewer."""
    keep: bool = False
    """Whether the page stays open after the run even if no terminal can end it."""

    def window(self, control: Control) -> tuple[Window, LiveCommands]:
        """Return the window of a run, and the commands of its page; WindowError if it cannot be opened."""
        from deploy.dashboard.windows import Window, WindowError  # noqa: PLC0415
        from deploy.run.live_commands import LiveCommands  # noqa: PLC0415

        commands = LiveCommands(control)
        seen = control.resume if self.wait else lambda: None
        window = Window(self.mode or "auto", errors.print, panel=commands, share=self.share, when_seen=seen)
        for flag, is_set in (("wait-for-viewer", self.wait), ("keep-serving", self.keep)):
            if is_set and window.mode != "web":
                raise WindowError(f"{flag}: needs a page; use --view-as web")
        if self.wait:
            control.pause()
            errors.print("The run starts when a viewer has opened the page.")
        return window, commands
