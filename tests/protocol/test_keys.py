"""Keys: plane, sender and receiver are read back from the key alone."""

from __future__ import annotations

import re

import pytest

from protocol import keys as names
from protocol.keys import Keys, number, parts, robot

KEYS = Keys("run-1")


def covers(expression: str, key: str) -> bool:
    """Zenoh's rule: `*` is one chunk, `**` any number of them."""
    pattern = re.escape(expression).replace(r"/\*\*", "(/.*)?").replace(r"\*", "[^/]+")
    return re.fullmatch(pattern, key) is not None


@pytest.mark.parametrize(
    ("key", "read"),
    [
        (KEYS.radio_tx("r0"), ("radio", "tx", "r0", "")),
        (KEYS.radio_rx("r1", "r0"), ("radio", "rx", "r1", "r0")),
        (KEYS.body("r1", names.WORLD), ("body", "rx", "r1", "world")),
        (KEYS.control("recorder", names.RELAY), ("control", "rx", "recorder", "relay")),
        (KEYS.control_tx("r2"), ("control", "tx", "r2", "")),
        (KEYS.presence("r2"), ("presence", "tx", "r2", "")),
    ],
)
def test_a_key_names_plane_direction_and_both_ends(key: str, read: tuple[str, str, str, str]) -> None:
    assert parts(key) == read


def test_each_key_lies_in_exactly_one_inbox() -> None:
    everyone = [names.RELAY, names.WORLD, names.RECORDER, "r0", "r1", "r10"]
    for plane in (KEYS.radio_rx, KEYS.body, KEYS.control):
        for owner in everyone[1:]:
            key = plane(owner, "someone")
            assert [name for name in everyone if covers(KEYS.inbox(name), key)] == [owner]
    for key in (KEYS.radio_tx("r1"), KEYS.control_tx("r0"), KEYS.presence("r1")):
        assert [name for name in everyone if covers(KEYS.inbox(name), key)] == [names.RELAY]


def test_the_name_of_a_robot_has_its_number() -> None:
    assert [number(robot(n)) for n in (0, 7, 63)] == [0, 7, 63]


@pytest.mark.parametrize("name", ["", "r", "R1", "relay", "r-1", "r1x", "1", "r 1", "r٣", "r²", "r01", "*"])
def test_other_names_are_no_robots(name: str) -> None:
    with pytest.raises(ValueError, match="is not the name of a robot"):
        number(name)


@pytest.mark.parametrize("run", ["", "a/b", "*", "a*", "$*", "a#b", "a?b", "a b", "ä"])
def test_a_run_name_that_would_break_its_keys_is_rejected(run: str) -> None:
    with pytest.raises(ValueError, match="letters, digits"):
        Keys(run)


@pytest.mark.parametrize("run", ["memory", "Intel_3-robots.2"])
def test_a_plain_name_makes_a_run(run: str) -> None:
    assert Keys(run).control_tx("r0") == f"murmur/{run}/control/tx/r0"
