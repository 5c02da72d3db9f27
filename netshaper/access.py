"""Access control: what each participant may send and receive, with one credential each; the hub refuses all else.

Credentials are new for each run. A robot may put under its own name only and receive only what is addressed to it;
it sees no subscriptions except those of relay, world, laboratory and viewer, so that it cannot even find another
robot to reach without the relay. Who may say anything to whom stands in `protocol.rights`.

Robots may join through a router (`netshaper.router`). It holds each of them to the same rules; and the hub lets it
say and hear what these robots may, and nothing more.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from protocol import keys as names
from protocol import rights
from protocol.keys import Keys
from protocol.zenoh_bus import Credential

PASSWORDS, CERTIFICATES = "usernames", "cert_common_names"
"""By what the hub knows who somebody is, in zenoh's words."""


def participants(robots: int) -> list[str]:
    """Names of all clients of a run with the given number of robots."""
    return [names.WORLD, names.RECORDER, names.VIEW, *(names.robot(number) for number in range(robots))]


def issue(run: str, hub: str, robots: int) -> dict[str, Credential]:
    """Make new credentials for all clients of a run, by name."""
    return passwords(run, hub, participants(robots))


def passwords(run: str, hub: str, clients: Iterable[str]) -> dict[str, Credential]:
    """Make new credentials for those who join at one place, by name."""
    return {name: Credential(run, name, hub, secrets.token_urlsafe(18)) for name in clients}


def speaking(credentials: Mapping[str, Credential]) -> dict[str, Sequence[str]]:
    """For whom each client of the hub speaks: a router for its robots, anybody else for itself."""
    return {name: credential.robots or (name,) for name, credential in credentials.items()}


def rules(keys: Keys, speaking: Mapping[str, Sequence[str]], by: str = PASSWORDS) -> dict[str, Any]:
    """Access control of the hub, in zenoh's form: deny by default, at most five rules a participant.

    `speaking` has the participants for whom each client speaks, `by` what the clients are known.
    """
    everyone = list(dict.fromkeys([*participants(0), *(name for whom in speaking.values() for name in whom)]))
    config: dict[str, Any] = {"enabled": True, "default_permission": "deny"}
    config["rules"], config["subjects"], config["policies"] = [], [], []
    for client, whom in speaking.items():
        allowed = [rule for name in whom for rule in _rules_of(keys, name, everyone)]
        _allow(config, {"id": client, by: [client]}, allowed)
    return config


def router_rules(keys: Keys, robots: Sequence[str]) -> dict[str, Any]:
    """Access control of a router: that of the hub for its robots; on the way to the hub it is the other way round."""
    config = rules(keys, {robot: [robot] for robot in robots})
    _allow(
        config, {"id": names.RELAY, CERTIFICATES: [names.RELAY]}, [_turned(rule) for rule in config["rules"]]
    )
    return config


def _rules_of(keys: Keys, name: str, everyone: list[str]) -> list[dict[str, Any]]:
    inbox = keys.inbox(name)
    allowed = {
        "put": ("put", "ingress", rights.may_put(keys, name)),
        "hear": ("put", "egress", [inbox]),
        "listen": ("declare_subscriber", "ingress", [inbox]),
        "live": ("liveliness_token", "ingress", [keys.alive(name)]),
        # Without it that a subscription is declared to a participant, its client sends nothing.
        "see": (
            "declare_subscriber",
            "egress",
            [keys.inbox(other) for other in rights.receivers(name, everyone)],
        ),
    }
    return [
        {
            "id": f"{name}-{what}",
            "permission": "allow",
            "messages": [message],
            "flows": [flow],
            "key_exprs": expressions,
        }
        for what, (message, flow, expressions) in allowed.items()
        if expressions
    ]


def _turned(rule: dict[str, Any]) -> dict[str, Any]:
    """A rule as it is seen from the other end of a connection."""
    (flow,) = rule["flows"]
    return rule | {"id": f"{rule['id']}-on", "flows": ["egress" if flow == "ingress" else "ingress"]}


def _allow(config: dict[str, Any], subject: dict[str, Any], allowed: list[dict[str, Any]]) -> None:
    config["rules"] += allowed
    config["subjects"].append(subject)
    config["policies"].append({"rules": [rule["id"] for rule in allowed], "subjects": [subject["id"]]})
