"""The hosts of a run: a TOML file that assigns robots to hosts, and configures SSH.

It is checked before anything starts.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, Field, ValidationError, field_validator, model_validator

from deploy.scenario.errors import ScenarioError, explained
from deploy.scenario.tables import Table, Whole
from deploy.scenario.toml_files import read_toml
from protocol.grid import MAX_ROBOTS

MOST_PORT = 65535

Truth = Annotated[bool, Field(strict=True)]
Port = Annotated[int, Field(strict=True, ge=1, le=MOST_PORT)]


def _matching(pattern: str, error: str) -> AfterValidator:
    """Check that a text matches a regular expression."""

    def check(text: str) -> str:
        if not re.fullmatch(pattern, text):
            raise ValueError(error)
        return text

    return AfterValidator(check)


Name = Annotated[
    str,
    _matching(r"[A-Za-z0-9][A-Za-z0-9._-]*", "must be letters, digits, '-', '_' and dots"),
    _matching(
        r"(?!(relay|world|recorder|view|r[0-9]+)$).*",
        "is the name of a process of the run; call the host something else",
    ),
]
SshTarget = Annotated[str, _matching(r"([^-\s]\S*)?", "must be HOST or USER@HOST, without spaces")]
SshOption = Annotated[
    str, _matching(r"[A-Za-z0-9]+\s*[=\s]\s*\S.*", "must be NAME=VALUE, as IdentityFile=~/.ssh/robots")
]
Command = Annotated[
    str, _matching(r".*\S.*", "must be a command on one line, as murmur or /opt/murmur/bin/murmur")
]
Address = Annotated[
    str,
    _matching(r"[A-Za-z0-9.:_-]+", "must be a host's name or an IP address, as 192.168.1.10"),
    _matching(
        r"(?!0\.0\.0\.0$|::$).*",
        "cannot be reached from other hosts; give the address by which they know this host",
    ),
]


class Host(Table):
    """Another host, and the robots that run there."""

    name: Name = Field(description="its name in messages and logs")
    ssh: SshTarget = Field(
        "", description="destination of ssh: HOST, USER@HOST, or a name of ~/.ssh/config; empty: the name"
    )
    port: Port | None = Field(None, description="port of its SSH server")
    options: tuple[SshOption, ...] = Field((), description="options of ssh, as in ssh_config(5)")
    command: Command = Field("murmur", description="shell command that starts Murmur there")
    robots: Whole | tuple[Whole, ...] = Field(
        description="number of robots there, or a list of their numbers"
    )
    router: Truth = Field(
        False, description="whether they share one connection through a router on that host"
    )

    @field_validator("robots")
    @classmethod
    def _robots_are_valid(cls, value: int | tuple[int, ...]) -> int | tuple[int, ...]:
        numbers = value if isinstance(value, tuple) else range(min(value, MAX_ROBOTS + 1))
        if not 1 <= len(numbers) <= MAX_ROBOTS or len(set(numbers)) < len(numbers) or min(numbers) < 0:
            raise ValueError("must be a number of robots, 1 or more, or a list of different numbers, from 0")
        return value

    @property
    def target(self) -> str:
        """The destination of ssh."""
        return self.ssh or self.name


class Hosts(Table):
    """The hub's address, and the other hosts. All other robots run on this host."""

    address: Address = Field(description="name or IP address by which the other hosts reach this one")
    port: Port | None = Field(None, description="port of the hub; default: any free port")
    host: tuple[Host, ...] = Field(description="the other hosts")

    @model_validator(mode="after")
    def _hosts_differ(self) -> Self:
        called = [host.name for host in self.host]
        if not called:
            raise ValueError("[[host]] is missing: a hosts file must list at least one other host")
        if len(set(called)) < len(called):
            raise ValueError(f"[[host]] names must differ: {', '.join(called)}")
        listed = [number for host in self.host if isinstance(host.robots, tuple) for number in host.robots]
        if len(set(listed)) < len(listed):
            raise ValueError(f"[[host]] robots: a robot is listed twice: {sorted(listed)}")
        return self

    def placing(self, robots: int) -> dict[str, list[int]]:
        """Return the numbers of the robots on each other host: first the listed ones, then the lowest free ones.

        Raises ScenarioError if the hosts have more robots than the run.
        """
        listed = {host.name: list(host.robots) for host in self.host if isinstance(host.robots, tuple)}
        taken = {number for numbers in listed.values() for number in numbers}
        free = [number for number in range(robots) if number not in taken]
        for host in self.host:
            if isinstance(host.robots, int):
                listed[host.name], free = free[: host.robots], free[host.robots :]
        missing = [number for number in taken if number >= robots]
        wanted = sum(host.robots if isinstance(host.robots, int) else len(host.robots) for host in self.host)
        if missing or sum(map(len, listed.values())) < wanted:
            of = f"robot {min(missing)}" if missing else f"{wanted} robots"
            raise ScenarioError(f"hosts: the file assigns {of}, but the scenario has robots = {robots}")
        return {host.name: listed[host.name] for host in self.host}


def load(path: Path) -> Hosts:
    """Read a hosts file.

    Raises ScenarioError if the file cannot be read, or keys or values are invalid; the message lists all of them.
    """
    path, data = read_toml(path, "hosts")
    return parse(data, f"hosts {path}")


def parse(data: dict[str, Any], where: str = "hosts") -> Hosts:
    """Validate hosts given as a dictionary; ScenarioError lists all errors."""
    try:
        return Hosts.model_validate(data)
    except ValidationError as error:
        raise explained(error, Hosts).within(where) from None
