"""Hosts files: validation, and the assignment of robots to hosts."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from deploy.run.hosts import Host, Hosts, load, parse
from deploy.run.ssh import command_line
from deploy.scenario.errors import ScenarioError


def hosts(*robots: object, **more: Any) -> Hosts:
    return parse(
        {
            "address": "192.168.1.10",
            "host": [{"name": f"rack-{n}", "robots": each} for n, each in enumerate(robots)],
        }
        | more
    )


def test_counts_take_the_lowest_robots_that_no_host_lists() -> None:
    assert hosts([1, 4], 2, 1).placing(8) == {"rack-0": [1, 4], "rack-1": [0, 2], "rack-2": [3]}


def test_hosts_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "hosts.toml"
    path.write_text('address = "hub"\nport = 7447\n[[host]]\nname = "a"\nssh = "me@a"\nrobots = 3\n')
    read = load(path)
    assert (read.address, read.port, read.host[0].target, read.host[0].command) == (
        "hub",
        7447,
        "me@a",
        "murmur",
    )
    with pytest.raises(ScenarioError, match=r"^hosts \S+missing\.toml: no such file$"):
        load(tmp_path / "missing.toml")
    path.write_text("address = ")
    with pytest.raises(ScenarioError, match=r"^hosts \S+hosts\.toml: not TOML"):
        load(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"address": "0.0.0.0"}, r"address = '0\.0\.0\.0': cannot be reached from other hosts"),
        ({"address": "10.0.0.1 x"}, r"address = '10\.0\.0\.1 x': must be a host's name"),
        ({"port": 70000}, r"port = 70000: .*less than or equal to 65535"),
        ({"host": []}, r"\[\[host\]\] is missing"),
        ({"hub": 1}, r"hub: unknown setting; there are: address, port, host"),
        ({"host": [{"name": "a"}]}, r"host\.0\.robots is missing"),
        (
            {"host": [{"name": "a", "robots": 1, "user": "me"}]},
            r"host\.0\.user: unknown setting; did you mean router\? There are: name",
        ),
        ({"host": [{"name": "a/b", "robots": 1}]}, r"host\.0\.name = 'a/b': must be letters"),
        ({"host": [{"name": "r1", "robots": 1}]}, r"host\.0\.name = 'r1': is the name of a process"),
        ({"host": [{"name": "a", "robots": 1, "router": 1}]}, r"host\.0\.router = 1: must be true or false"),
        ({"host": [{"name": "a", "robots": 0}]}, r"host\.0\.robots = 0: must be a number of robots"),
        (
            {"host": [{"name": "a", "robots": [1, 1]}]},
            r"must be a number of robots, 1 or more, or a list of different",
        ),
        (
            {"host": [{"name": "a", "robots": 1, "ssh": "-oProxyCommand=x"}]},
            r"ssh = .*must be HOST or USER@HOST",
        ),
        ({"host": [{"name": "a", "robots": 1, "options": ["-v"]}]}, r"options.0 = '-v': must be NAME=VALUE"),
        (
            {"host": [{"name": "a", "robots": 1, "command": " "}]},
            r"command = ' ': must be a command on one line",
        ),
        ({"host": 2 * [{"name": "a", "robots": 1}]}, r"\[\[host\]\] names must differ: a, a"),
        (
            {"host": [{"name": "a", "robots": [1]}, {"name": "b", "robots": [1, 2]}]},
            r"a robot is listed twice: \[1, 1, 2\]",
        ),
    ],
)
def test_error_states_the_invalid_value_and_the_expected_form(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        hosts(1, **changes)


@pytest.mark.parametrize(
    ("robots", "message"),
    [
        ((3, 2), r"the file assigns 5 robots, but the scenario has robots = 4"),
        (([4],), r"the file assigns robot 4, but the scenario has robots = 4"),
        (([0, 1, 2], 2), r"the file assigns 5 robots, but"),
    ],
)
def test_hosts_with_more_robots_than_the_run_are_rejected(robots: tuple[object, ...], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        hosts(*robots).placing(4)


def test_options_of_the_hosts_file_come_first_and_ssh_never_asks_for_a_password() -> None:
    (host,) = hosts(
        1, host=[{"name": "a", "ssh": "me@a", "port": 22, "robots": 1, "options": ["BatchMode=no"]}]
    ).host
    line = command_line(host, {})
    assert line[:1] == ["ssh"]
    assert line[-3:] == ["--", "me@a", "murmur run agents"]
    assert line.index("BatchMode=no") < line.index("BatchMode=yes")
    assert line[line.index("-p") + 1] == "22"


DOCUMENT = (Path(__file__).parents[3] / "docs" / "hosts.md").read_text(encoding="utf-8")


def test_hosts_files_in_the_documentation_are_valid() -> None:
    files = re.findall(r"^```toml\n(.*?)^```$", DOCUMENT, re.M | re.S)
    two_laptops, rack = (parse(tomllib.loads(text)) for text in files)
    assert two_laptops.placing(4) == {"second": [0, 1]}
    assert rack.placing(25) == {
        "rack-1": [n for n in range(1, 23) if n not in (7, 21)],
        "rack-2": [0, 7, 21],
    }


def test_documentation_lists_every_setting_with_its_default() -> None:
    documented = dict(re.findall(r"^\| `([a-z.]+)` \| (.*?) \| .* \|$", DOCUMENT, re.M))
    plain: dict[object, str] = {None: "-", "": '`""`', (): "`[]`", False: "`false`"}
    wanted = {}
    for prefix, kind in (("", Hosts), ("host.", Host)):
        for name, info in kind.model_fields.items():
            if (prefix, name) != ("", "host"):
                default = info.default
                value = "required" if info.is_required() else plain.get(default, f'`"{default}"`')
                wanted[prefix + name] = value
                assert f"| {value} | {info.description} |" in DOCUMENT, name
    assert documented == wanted
