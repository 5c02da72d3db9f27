"""The other end of the edit scripts: rebuilding a teammate's approximation from its packets (section 4.2.3).

Packets build up a draft; only a save point makes it the approximation that is used. A piece of the stream
that contradicts itself or what came before, or that says what cannot be, is refused as a whole.
"""

from __future__ import annotations

from collections.abc import Callable
from hashlib import blake2b

from agent.memo_cache import NO_CACHE, MemoCache
from agent.outline.draft import Draft
from agent.outline.edit_reader import Reading, Saved, read
from agent.outline.edits import Held
from agent.outline.objects import FIRST, INSIDE, LENGTH, Objects
from protocol.boxes import NO_BOXES, Boxes, union


class Receiver:
    """Holds one teammate's approximation and takes the packets that change it.

    Parameters
    ----------
    shape : (int, int)
        Height and width of the grid, in cells; no vertex may lie beyond the rim of one cell around it.
    cache : MemoCache
        Cache of intermediate results, shared by the robots of this process.
    """

    def __init__(self, shape: tuple[int, int], cache: MemoCache = NO_CACHE) -> None:
        self._cache = cache
        self._heard = blake2b(digest_size=16)
        """Of all that has been heard: what follows from it."""
        self.objects = Objects.nothing(shape)
        """The approximation as of the last save point."""
        self._reading = Reading.nothing(shape)
        self._pending = b""
        self._held: Held | None = None
        self._changed: Boxes = NO_BOXES

    @property
    def held(self) -> Held:
        """The same as polygons."""
        if self._held is None:
            self._held = Held(*self.objects.polygons())
        return self._held

    def changed(self) -> Boxes:
        """Where what is held would be drawn differently than when this was last asked."""
        boxes, self._changed = self._changed, NO_BOXES
        return boxes

    def feed(self, data: bytes, check: Callable[[Saved], object] = lambda _: None) -> bool:
        """Take the next piece of the stream, cut anywhere; say whether a save point was in it.

        `check` is called with what it saves, if anything; it may refuse that.

        Raises
        ------
        ProtocolError
            The piece makes no sense; nothing has changed. Its offset counts from the first packet of which
            a part is in this piece.
        """
        piece = self._pending + data
        before, heard = self._reading, self._heard.digest()
        found = self._cache.get((heard, piece), lambda: read(before, piece))
        if found is None or found[0] < len(piece):  # something is wrong, or a packet is not complete
            _draft_of(self._reading).read(self._pending, data)
        if found is None:
            raise RuntimeError("a piece was refused in which each packet makes sense")
        if found[2] is not None:
            check(found[2])
        used, self._reading, saved = found
        self._pending = piece[used:]
        behind = saved.end - (len(piece) - len(data)) if saved is not None else 0
        self._heard.update(data[:behind])
        if saved is not None:
            self.objects, self._held = self._cache.get(self._heard.digest(), lambda: saved.objects), None
            self._changed = union(self._changed, saved.boxes)
        self._heard.update(data[behind:])
        return saved is not None


def _draft_of(reading: Reading) -> Draft:
    """What has been read, in plain form."""
    objects = reading.objects
    number, count, inside, is_saved = reading.header
    outlines = {
        each: (objects.pool[row[FIRST] : row[FIRST] + row[LENGTH]], bool(row[INSIDE]))
        for each, row in enumerate(objects.table)
        if row[FIRST] >= 0
    }
    vertices = reading.vertices.tolist()
    return Draft(
        objects.shape, outlines, None if number < 0 else number, vertices, count, inside, not is_saved
    )
