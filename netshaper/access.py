"""Access control: what each participant may send and receive, with one credential each; the hub refuses all else.

Credentials are new for each run. A robot may put under its own name only and receive only what is addressed to it;
it sees no subscriptions except those of relay, world, laboratory and viewer, so that it cannot even find another
robot to reach without the relay.
"""

from __future__ import annotations

import secrets
from typing import Any

from protocol import keys as names
from protocol.keys import Keys
from protocol.zenoh_bus import Credential

PASSWORDS, CERTIFICATES = "usernames", "cert_common_names"
"""By what the hub knows who somebody is, in zenoh's words."""


def participants(robots: int) -> list[str]:
    """Names of all clients of a run with the given number of robots."""
    return [names.WORLD, names.LAB, names.VIEW, *(names.robot(number) for number in range(robots))]


def issue(run: str, hub: str, robots: int) -> dict[str, Credential]:
    """Make new credentials for all clients of a run, by name."""
    return {name: Credential(run, name, hub, secrets.token_urlsafe(18)) for name in participants(robots)}


def rules(keys: Keys, robots: int, by: str = PASSWORDS) -> dict[str, Any]:
    """Access control of the hub, in zenoh's form: deny by default, at most five rules a participant."""
    everyone = participants(robots)
    config: dict[str, Any] = {"enabled": True, "default_permission": "deny"}
    config["rules"], config["subjects"], config["policies"] = [], [], []
    for name in everyone:
        inbox = keys.inbox(name)
        allowed = {
            "put": ("put", "ingress", _may_put(keys, name)),
            "hear": ("put", "egress", [inbox]),
            "listen": ("declare_subscriber", "ingress", [inbox]),
            "live": ("liveliness_token", "ingress", [keys.alive(name)]),
            "see": ("declare_subscriber", "egress", _may_see(keys, name, everyone)),
        }
        rules = [
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
        config["rules"] += rules
        config["subjects"].append({"id": name, by: [name]})
        config["policies"].append({"rules": [rule["id"] for rule in rules], "subjects": [name]})
    return config


def _may_put(keys: Keys, name: str) -> list[str]:
    if name == names.VIEW:
        return []
    if name == names.LAB:
        return [keys.control_tx(name)]
    reports = [keys.control_tx(name), keys.control(names.LAB, name), keys.control(names.VIEW, name)]
    if name == names.WORLD:
        return [*reports, keys.body("*", name)]
    return [*reports, keys.radio_tx(name, "*"), keys.body(names.WORLD, name)]


def _may_see(keys: Keys, name: str, everyone: list[str]) -> list[str]:
    """Subscriptions that are declared to a participant: without that, its client sends nothing."""
    relay = keys.inbox(names.RELAY)
    if name == names.VIEW:
        return []
    if name == names.LAB:
        return [relay]
    if name == names.WORLD:
        return [relay, *(keys.inbox(other) for other in everyone if other != name)]
    return [relay, keys.inbox(names.WORLD), keys.inbox(names.LAB), keys.inbox(names.VIEW)]
