"""Attachments: what rmw_zenoh adds to each message, request, and response.

33 bytes, little-endian: sequence number (int64), time of sending (int64, nanoseconds since 1970), the length 16 of the
gid, and the gid of the sending endpoint (`protocol.ros2.tokens.gid`).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from protocol.errors import ProtocolError

GID_BYTES = 16
_FORM = struct.Struct("<qqB16s")


@dataclass(frozen=True)
class Attachment:
    """The attachment of one message: its number at the sender, from 1, its time of sending, and the sender's gid.

    A response has the number and the gid of the request.
    """

    sequence: int
    stamp_ns: int
    gid: bytes

    def encode(self) -> bytes:
        """Return the bytes on the wire."""
        return _FORM.pack(self.sequence, self.stamp_ns, GID_BYTES, self.gid)


def decode_attachment(data: bytes | None) -> Attachment:
    """Decode an attachment; ProtocolError if it is missing or malformed."""
    if data is None or len(data) != _FORM.size:
        found = "none" if data is None else f"{len(data)} bytes"
        raise ProtocolError("ROS 2 attachment", 0, f"{found} instead of {_FORM.size} bytes")
    sequence, stamp_ns, length, gid = _FORM.unpack(data)
    if length != GID_BYTES:
        raise ProtocolError("ROS 2 attachment", 16, f"length of the gid is {length} instead of {GID_BYTES}")
    if sequence < 0 or stamp_ns < 0:
        raise ProtocolError(
            "ROS 2 attachment", 0, f"negative: sequence number {sequence}, time {stamp_ns} ns"
        )
    return Attachment(sequence, stamp_ns, gid)
