"""The exception for runs without a usable result."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from deploy.run.result import Result


class RunFailed(RuntimeError):  # noqa: N818  a run failed, which is more than an error in the call
    """A run was aborted, or all its robots were lost unexpectedly; or all runs of a study's settings failed."""

    def __init__(self, reason: str, result: Result | None = None) -> None:
        super().__init__(reason)
        self.result = result
        """The results up to the failure, for a single run."""
