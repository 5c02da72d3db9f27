"""The error raised for any malformed data from the radio or the bus."""

from __future__ import annotations


class ProtocolError(ValueError):
    """Malformed bytes.

    Attributes
    ----------
    packet : str
        The packet or message that was being read.
    offset : int
        Where in the buffer it begins, in bytes.
    reason : str
        What is wrong and what would be right.
    """

    def __init__(self, packet: str, offset: int, reason: str) -> None:
        super().__init__(f"{packet} at byte {offset}: {reason}")
        self.packet = packet
        self.offset = offset
        self.reason = reason
