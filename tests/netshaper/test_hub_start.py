"""Participants that join while the hub starts: their first messages arrive."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import pytest

from deploy.dashboard.windows import free_port
from netshaper import access, hub
from protocol import keys as names
from protocol.bus import Message
from protocol.keys import Keys
from protocol.zenoh_bus import ZenohBus, join


@pytest.mark.parametrize("name", [names.RECORDER, names.robot(0)])
def test_messages_arrive_that_are_sent_before_the_relay_receives(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    def subscribe_late(*args: object) -> ZenohBus:
        time.sleep(0.5)
        return ZenohBus(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(hub, "ZenohBus", subscribe_late)
    endpoint, sent = f"tcp/127.0.0.1:{free_port()}", Message(Keys("run").control_tx(name), b"settings")
    credentials = access.issue("run", endpoint, 1)
    with ThreadPoolExecutor() as executor:
        opening = executor.submit(hub.open_hub, "run", endpoint, credentials)
        with closing(join(credentials[name])) as participant:
            participant.put(*sent)
            with closing(opening.result()) as relay:
                received = [relay.receive(1.0) for _ in range(2)]
    assert sent in received
