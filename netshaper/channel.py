"""What becomes of a frame on its way to one robot: heard, lost, damaged, late, or heard twice.

Frames are lost independently of each other, and more of them in bursts, in which a link of two robots is bad for some
steps (Gilbert and Elliott's chain of two states). A flipped bit is found by the checksum, and the frame dropped. All
of it is drawn by the frame and its hearer (`protocol.keyed_random`), so who else is in range changes nothing.
"""

from __future__ import annotations

import binascii
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from netshaper.ledger import CAUSES
from netshaper.radio_options import RadioOptions
from protocol import packets
from protocol.keyed_random import keyed_random
from protocol.packets import Check

HEARD, LOSS, DAMAGED = (CAUSES.index(cause) for cause in ("", "loss", "damaged"))


class Reception(NamedTuple):
    """What one robot gets of frames that belong together.

    `frames`: those that came before the first one that did not; of what comes behind a gap nothing can be made.
    `cause`: why there are not all, in `CAUSES`. `delays`: after how many steps, once a copy.
    """

    frames: list[bytes]
    cause: int
    delays: list[int]


class Channel:
    """All links of a run."""

    def __init__(self, options: RadioOptions, seed: int, robots: int) -> None:
        self._options = options
        self._seed = seed
        self._bad: NDArray[np.bool_] = np.zeros((robots, robots), np.bool_)

    def next_step(self, step: int) -> None:
        """Let bursts begin and end."""
        if self._options.burst_every:
            draws = keyed_random(self._seed, "bursts", step).random(self._bad.shape)
            self._bad = next_bursts(self._bad, draws, self._options.burst_every, self._options.burst_steps)

    def carry(
        self,
        step: int,
        round_number: int,
        sender: int,
        number: int,
        frames: Sequence[bytes],
        hearers: Sequence[int],
    ) -> list[Reception]:
        """Carry frames that belong together to each of `hearers`; `number` counts what a sender says in an exchange."""
        options = self._options
        random = keyed_random(self._seed, "channel", step, round_number, sender, number)
        draws = random.random((len(self._bad), 2 * len(frames) + 2))
        receptions = []
        for hearer in hearers:
            lost = options.burst_loss if self._bad[sender, hearer] else options.loss
            twice, later, *mine = draws[hearer].tolist()
            got: list[bytes] = []
            cause = HEARD
            for index, frame in enumerate(frames):
                heard: bytes | None = frame
                if mine[2 * index] < lost:
                    cause = LOSS
                    break
                if mine[2 * index + 1] < chance_of_damage(len(frame), options.bit_errors):
                    key = (step, round_number, sender, number, hearer, index)
                    heard = unsum(flip(frame, options.bit_errors, keyed_random(self._seed, "flips", *key)))
                elif options.sums:
                    heard = unsum(frame)
                if heard is None:
                    cause = DAMAGED
                    break
                got.append(heard)
            delay = options.delay + int(later * (options.jitter + 1))
            receptions.append(
                Reception(got, cause, [delay, delay] if twice < options.duplication else [delay])
            )
        return receptions


def next_bursts(
    bad: NDArray[np.bool_], draws: NDArray[np.float64], every: float, steps: float
) -> NDArray[np.bool_]:
    """The links that are bad in the next step, symmetric; `draws`: uniform numbers, of which the upper half counts."""
    both = np.triu(draws, 1)
    both = both + both.T
    return np.where(bad, both >= 1 / steps, both < 1 / every) & ~np.eye(len(bad), dtype=np.bool_)


def chance_of_damage(size: int, bit_errors: float) -> float:
    """How likely it is that a frame of so many bytes has a flipped bit."""
    return float(1 - (1 - bit_errors) ** (8 * size))


def flip(frame: bytes, bit_errors: float, random: np.random.Generator) -> bytes:
    """Flip bits of a frame, at least one, each as likely as any other."""
    flips = random.random(8 * len(frame)) < bit_errors
    flips[random.integers(len(flips))] = True
    return bytes(np.frombuffer(frame, np.uint8) ^ np.packbits(flips))


def with_sum(frame: bytes) -> bytes:
    """A frame with its checksum behind it: CRC-16 with x^16 + x^12 + x^5 + 1, as in IEEE 802.15.4 and LoRa."""
    return frame + packets.encode([Check(binascii.crc_hqx(frame, 0))])


def unsum(frame: bytes) -> bytes | None:
    """The frame without its checksum; None if that does not fit."""
    content = frame[: -Check.size]
    return content if with_sum(content) == frame else None
