"""Channel model: loss, delay, damage and duplication of frames.

Frames are lost independently of each other. During a burst, a link is bad for some steps and loses more frames (the
two-state chain of Gilbert and Elliott). A receiver finds a flipped bit by the checksum and drops the frame. Random
draws are keyed by frame and receiver (`protocol.keyed_random`), so other robots in range do not change them. The
channel of a perfect radio has none of these effects.
"""

from __future__ import annotations

import binascii
from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from netshaper.ledger import CAUSES
from netshaper.radio_options import ChannelOptions
from protocol import packet_codec
from protocol.keyed_random import keyed_random
from protocol.packets import Check

RECEIVED, LOSS, DAMAGED = (CAUSES.index(cause) for cause in ("", "loss", "damaged"))


class Reception(msgspec.Struct, frozen=True, gc=False):
    """The part of a frame sequence that robots receive.

    `frames`: those before the first missing one, without checksums; frames after a gap are discarded. `cause`: the
    cause of missing frames, in `CAUSES`. `delay`: steps until it arrives. `copies`: how often it arrives.
    """

    receivers: Sequence[int]
    frames: Sequence[bytes]
    cause: int
    delay: int = 0
    copies: int = 1


class Channel:
    """The links between all robots of a run."""

    def __init__(self, options: ChannelOptions, seed: int, robots: int) -> None:
        self._options = options
        self._seed = seed
        self._bad: NDArray[np.bool_] = np.zeros((robots, robots), np.bool_)

    def next_step(self, step: int) -> None:
        """Begin and end bursts."""
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
        receivers: Sequence[int],
    ) -> list[Reception]:
        """Carry a sequence of frames to each receiver, in their order; robots with equal receptions may share one.

        `number` is the position of the sequence among those of its sender and round.
        """
        options = self._options
        if options.lossless:
            return [Reception(receivers, frames, RECEIVED)]
        random = keyed_random(self._seed, "channel", step, round_number, sender, number)
        draws = random.random((len(self._bad), 2 * len(frames) + 2))
        receptions = []
        for receiver in receivers:
            lost = options.burst_loss if self._bad[sender, receiver] else options.loss
            twice, later, *mine = draws[receiver].tolist()
            arrived: list[bytes] = []
            cause = RECEIVED
            for index, frame in enumerate(frames):
                if mine[2 * index] < lost:
                    cause = LOSS
                    break
                received = frame
                if mine[2 * index + 1] < chance_of_damage(len(frame), options.bit_errors):
                    key = (step, round_number, sender, number, receiver, index)
                    received = flip(frame, options.bit_errors, keyed_random(self._seed, "flips", *key))
                content = without_checksum(received) if options.sums else received
                if content is None:
                    cause = DAMAGED
                    break
                arrived.append(content)
            delay = options.delay + int(later * (options.jitter + 1))
            copies = 2 if twice < options.duplication else 1
            receptions.append(Reception([receiver], arrived, cause, delay, copies))
        return receptions


def next_bursts(
    bad: NDArray[np.bool_], draws: NDArray[np.float64], every: float, steps: float
) -> NDArray[np.bool_]:
    """Return the links that are bad in the next step, symmetric, by the upper triangle of the uniform `draws`."""
    both = np.triu(draws, 1)
    both = both + both.T
    return np.where(bad, both >= 1 / steps, both < 1 / every) & ~np.eye(len(bad), dtype=np.bool_)


def chance_of_damage(size: int, bit_errors: float) -> float:
    """Return the probability that a frame of `size` bytes has a flipped bit."""
    return float(1 - (1 - bit_errors) ** (8 * size))


def flip(frame: bytes, bit_errors: float, random: np.random.Generator) -> bytes:
    """Flip bits of a frame, at least one, each as likely as any other."""
    flips = random.random(8 * len(frame)) < bit_errors
    flips[random.integers(len(flips))] = True
    return bytes(np.frombuffer(frame, np.uint8) ^ np.packbits(flips))


def with_checksum(frame: bytes) -> bytes:
    """Append the checksum to a frame: CRC-16 with x^16 + x^12 + x^5 + 1, as in IEEE 802.15.4 and LoRa."""
    return frame + packet_codec.encode([Check(binascii.crc_hqx(frame, 0))])


def without_checksum(frame: bytes) -> bytes | None:
    """Return a frame without its checksum; None if the checksum is wrong."""
    content = frame[: -Check.size]
    return content if with_checksum(content) == frame else None
