"""Access control: what each participant may send and receive, with one credential each; the hub refuses all else.

Credentials are new for each run. A robot may put under its own name only and receive only what is addressed to it;
it sees no subscriptions except those of relay, world, laboratory and viewer, so that it cannot even find another
robot to reach without the relay. Who may say anything to whom stands in `protocol.rights`.
"""

from __future__ import annotations

import secrets
from typing import Any

from protocol import keys as names
from protocol import rights
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
            "put": ("put", "ingress", rights.may_put(keys, name)),
            "hear": ("put", "egress", [inbox]),
            "listen": ("declare_subscriber", "ingress", [inbox]),
            "live": ("liveliness_token", "ingress", [keys.alive(name)]),
            # Without it that a subscription is declared to a participant, its client sends nothing.
            "see": (
                "declare_subscriber",
                "egress",
                [keys.inbox(other) for other in rights.hearers(name, everyone)],
            ),
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
