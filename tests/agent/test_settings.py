"""Settings of a robot on the wire: they are read as they were sent, or refused with what is wrong."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from agent.settings import EncodingSettings, ReplicationSettings, Settings
from protocol.body import Body
from protocol.errors import ProtocolError
from protocol.range_scans import Laser

LASER = Laser(5, 0, 50_000, 8000)
SETTINGS = Settings(
    robot=1, bodies=(Body(8.0, 360.0, 5.0, laser=LASER),) * 3, width=40, height=30, beams=36, seed=0, strategy="meier",
    encoding=EncodingSettings("predictive", tolerance=1), replication=ReplicationSettings("gossip"),
    home=(3, 4), options={"weight": 0.5},
)  # fmt: skip


def test_settings_are_read_as_they_were_sent() -> None:
    assert Settings.decode(SETTINGS.encode()) == SETTINGS


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"robot": 3}, "robot = 3: the team has 3 robots"),
        ({"robot": -1}, "robot = -1: the team has 3 robots"),
        ({"bodies": []}, "robot = 1: the team has 0 robots"),
        ({"bodies": [SETTINGS.body, Body(8.0, 360.0, 5.0)]}, "all robots, or none, must have a laser"),
        ({"width": 0}, r"`\$.width`"),
        ({"height": 1 << 40}, r"`\$.height`"),
        ({"encoding": {"name": 7}}, r"`\$.encoding.name`"),
        ({"replication": {}}, "missing required field `dissemination`"),
        ({"color": "red"}, "unknown field `color`"),
    ],
)
def test_settings_that_no_robot_can_have_are_refused(change: dict[str, Any], problem: str) -> None:
    data = msgspec.to_builtins(SETTINGS) | change
    with pytest.raises(ProtocolError, match=problem):
        Settings.decode(msgspec.msgpack.encode(data))


def test_truncated_settings_are_refused() -> None:
    data = SETTINGS.encode()
    for end in range(0, len(data), 7):
        with pytest.raises(ProtocolError, match="not a robot's settings"):
            Settings.decode(data[:end])
