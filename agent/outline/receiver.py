"""Receiver of edit scripts: rebuilds a teammate's approximation from its packets (section 4.2.3).

Packets take effect at the next save point. A chunk of the stream with a packet that is malformed, or that does not fit
the packets before it, is rejected as a whole.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from hashlib import blake2b

from agent.memo_cache import NO_CACHE, MemoCache
from agent.outline.edit_reader import ReaderState, SavePoint, read
from agent.outline.edits import NumberedPolygons
from agent.outline.objects import Objects
from protocol.boxes import NO_BOXES, Boxes, union


class Receiver:
    """One teammate's approximation, as its packets describe it.

    Vertices may lie at most one cell outside of the grid of `shape`, (height, width). Robots of this process share
    intermediate results by the `cache`.
    """

    def __init__(self, shape: tuple[int, int], cache: MemoCache = NO_CACHE) -> None:
        self._cache = cache
        self._digest = blake2b(digest_size=16)
        """Hash of all complete chunks so far: robots with equal hashes share results."""
        self.objects = Objects.empty(shape)
        """The approximation as of the last save point."""
        self._reading = ReaderState.empty(shape)
        self._pending = b""
        self._held: NumberedPolygons | None = None
        self._changed: Boxes = NO_BOXES

    @property
    def held(self) -> NumberedPolygons:
        """The approximation as polygons."""
        if self._held is None:
            self._held = _numbered(self.objects)
        return self._held

    def changed(self) -> Boxes:
        """Return boxes that contain all changes of the drawing since the last call."""
        boxes, self._changed = self._changed, NO_BOXES
        return boxes

    def feed(self, data: bytes, check: Callable[[SavePoint], object] = lambda _: None) -> bool:
        """Apply the next chunk of the stream, cut anywhere; return whether it contained a save point.

        If it did, `check` is called with the last one, and may raise an error to reject the chunk. ProtocolError: the
        chunk is malformed; nothing has changed. The offset is relative to the start of the first packet that ends in
        this chunk.
        """
        chunk = self._pending + data
        before, prefix = self._reading, self._digest.digest()
        used, reading, saved = self._cache.get((prefix, chunk), lambda: read(before, chunk))
        if saved is not None:
            check(saved)
        self._reading = reading
        self._pending = chunk[used:]
        behind = saved.end - (len(chunk) - len(data)) if saved is not None else 0
        self._digest.update(data[:behind])
        if saved is not None:
            self.objects, self._held = self._cache.get(self._digest.digest(), lambda: saved.objects), None
            self._changed = union(self._changed, saved.boxes)
        self._digest.update(data[behind:])
        return saved is not None


@lru_cache(maxsize=256)
def _numbered(objects: Objects) -> NumberedPolygons:
    """Return objects as polygons; robots of this process that hold the same objects share the result."""
    return NumberedPolygons(*objects.polygons())
