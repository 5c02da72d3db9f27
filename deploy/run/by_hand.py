"""Processes of a run that the user starts one by one, in several terminals or on several hosts.

See docs/several-terminals.md. Next to the credentials is the scenario of the netshaper, with which the other processes
compare theirs.
"""

from __future__ import annotations

import hashlib
import math
import re
import secrets
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import replace
from ipaddress import ip_address
from pathlib import Path
from typing import Any

from deploy.dashboard.process import ViewTask, serve
from deploy.dashboard.windows import Window, free_port
from deploy.record import run_directory
from deploy.record.code_digest import code_digest
from deploy.record.records import RecorderNode, Records
from deploy.run.hosts import MOST_PORT
from deploy.run.interrupt import Interrupt
from deploy.run.launch import Outcome, attend
from deploy.run.processes import WorldTask, relay, serve_agent, serve_world
from deploy.run.remote_agents import STARTERS
from deploy.run.result import Result, conclude
from deploy.scenario import plan as plans
from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario, load
from netshaper import access
from netshaper.hub import open_hub
from netshaper.router import Router
from protocol import keys as names
from protocol.bus import BusClosed
from protocol.keys import Keys
from protocol.zenoh_bus import Credential, certificate_fault, join
from worldsim.maps import Map

STANDARD_INPUT = Path("-")


def serve_netshaper(
    scenario: Scenario, listen: str, folder: Path, notify: Callable[[str], object], keys: Path | None = None
) -> None:
    """Write credentials for a new run into `folder`, then serve as its hub and relay.

    Raises ConnectionError if the run was broken off, as after the death of the world or the recorder.

    With `keys`, a directory that `murmur keys` made, participants authenticate with its certificates, else with
    passwords.
    """
    _load_kernels()
    plan = plans.make(scenario)
    _check_new(folder)
    endpoint = _endpoint(listen)
    run = secrets.token_hex(4)
    credentials = access.issue(run, endpoint, scenario.robots)
    certificate = None
    if keys is not None:
        from netshaper import certificate_check, certificates  # noqa: PLC0415  not needed for passwords

        made = certificates.read(keys, scenario.robots)
        certificate_check.check(keys, made, listen.rpartition(":")[0])
        endpoint = endpoint.replace("tcp/", "tls/", 1)
        credentials, certificate = certificates.credentials(run, endpoint, made), made[names.RELAY]
    with closing(open_hub(run, endpoint, credentials, certificate)) as bus:
        _hand_out(credentials, folder, _map_digest(plan.map))
        (folder / run_directory.SCENARIO).write_text(scenario.to_toml(), encoding="utf-8")
        notify(f"run {run} at {endpoint}; credentials in {folder}: {', '.join(credentials)}")
        fault = relay(bus, run, plan.radio, scenario.reply_timeout_s, notify=notify)
    if fault:
        raise ConnectionError(f"the run was broken off: {fault}")


def serve_routing(credential: Path, listen: str, folder: Path, notify: Callable[[str], object]) -> None:
    """Write credentials for a router's robots into `folder`, then serve as the router until the hub is gone."""
    read = _read(credential)
    if not read.robots:
        raise ScenarioError(
            f"credential {credential} is that of {read.name}; a router's is needed here, "
            "as murmur run netshaper writes it for keys that were made with --router"
        )
    _check_new(folder)
    endpoint = _endpoint(listen)
    credentials = access.passwords(read.run, endpoint, read.robots)
    with closing(Router(read, endpoint, credentials)) as router:
        _hand_out(credentials, folder)
        where = f"credentials in {folder}: {', '.join(credentials)}"
        notify(f"{read.name} of run {read.run} at {endpoint}; {where}")
        router.serve()


def _check_new(folder: Path) -> None:
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ScenarioError(f"credentials = {folder}: it exists already; name a new directory")


def _hand_out(credentials: Mapping[str, Credential], folder: Path, map_digest: str = "") -> None:
    folder.mkdir(parents=True, exist_ok=True)
    code = code_digest(STARTERS)
    for name, credential in credentials.items():
        replace(credential, code=code, map=map_digest).write(folder / f"{name}.json")


def _endpoint(listen: str) -> str:
    """Return the hub's address in zenoh's form, as every credential contains it.

    Raises ScenarioError if the address is malformed, or the hub cannot listen there.
    """
    parts = re.fullmatch(r"(\[[0-9A-Fa-f:.]+\]|[^\s\[\]:]+):([0-9]{1,5})", listen)
    if parts is None or not 1 <= int(parts[2]) <= MOST_PORT:
        raise ScenarioError(
            f"listen = {listen!r}: must be HOST:PORT, as 127.0.0.1:7447 or [::1]:7447, "
            f"with a port from 1 to {MOST_PORT}"
        )
    if _is_everywhere(parts[1]):
        raise ScenarioError(
            f"listen = {listen!r}: {parts[1]} cannot be reached from other hosts; "
            "every credential contains this address: give one by which others know this host"
        )
    try:
        free_port(parts[1].strip("[]"), int(parts[2]))
    except OSError as error:
        raise ScenarioError(
            f"listen = {listen!r}: cannot listen there: {error.strerror}; "
            "it must be an address of this host, and a free port"
        ) from None
    return f"tcp/{listen}"


def _is_everywhere(host: str) -> bool:
    """Return whether a host is the unspecified address, which means all interfaces."""
    try:
        return ip_address(host.strip("[]")).is_unspecified
    except ValueError:
        return False  # a host name


def serve_worldsim(scenario: Scenario, credential: Path) -> None:
    """Serve as the world of the run that the credential belongs to."""
    _check_same(scenario, credential)
    _load_kernels()
    plan = plans.make(scenario)
    read = _credential(credential, names.WORLD)
    _check_map(plan, read)
    limit = scenario.reply_timeout_s
    task = WorldTask(plan.make_world(), scenario.steps, 1000 * plan.map.resolution, reply_timeout_s=limit)
    serve_world(read, task)


def serve_robot(credential: Path) -> None:
    """Serve as the robot that the credential names; ``-`` is standard input."""
    if credential == STANDARD_INPUT:
        read = Credential.parse(sys.stdin.read(), "credential on standard input")
        _check(read, "credential on standard input")
    else:
        read = _read(credential)
        beside = credential.parent / run_directory.SCENARIO
        if beside.exists():
            load(beside, {})  # before it joins: are its plug-ins here?
    names.number(read.name)
    _load_kernels()
    serve_agent(read)


def serve_recorder(
    scenario: Scenario,
    credential: Path,
    out: Path | None,
    watch: Callable[[Plan, Records], object] | None,
    notify: Callable[[str], object] = lambda _: None,
) -> Result:
    """Serve as the recorder: record the run and write its directory; `notify` is called once Ctrl-C takes effect."""
    _check_same(scenario, credential)
    plan = plans.make(scenario, record_maps=True)
    read = _credential(credential, names.RECORDER)
    _check_map(plan, read)
    run_directory.check_free(out)
    bus = join(read)
    interrupt = Interrupt(notify)
    deaths: dict[str, str] = {}
    with interrupt.caught():
        with closing(bus):
            directory = run_directory.create(out, plan)
            began = time.perf_counter()
            with run_directory.open_capture(directory, plan) as capture:
                recorder = RecorderNode(bus, Keys(read.run), scenario.robots, plan.map.cells.shape, capture)
                recorder.configure(plan.robot_settings)

                def poll() -> bool:
                    if watch is not None:
                        watch(plan, recorder.records)
                    return False

                try:
                    attend(bus, recorder, interrupt.heed, poll, scenario.reply_timeout_s, math.inf)
                except BusClosed as error:
                    deaths[names.RELAY] = str(error)
        outcome = Outcome(recorder.records, deaths)
        if capture is not None and capture.failure is not None:
            outcome.failures.append(capture.failure)
        return conclude(plan, outcome, directory, time.perf_counter() - began)


def serve_viewer(scenario: Scenario, credential: Path, out: Path, window: Window) -> None:
    """Serve as a viewer: show a run and record it into `out`, from now to its end."""
    _check_same(scenario, credential)
    out.mkdir(parents=True, exist_ok=True)
    plan, read = plans.make(scenario), _credential(credential, names.VIEW)
    _check_map(plan, read)
    serve(read, ViewTask(plan, out, port=window.port), window.open)


def _load_kernels() -> None:
    """Load all kernels, and compile those that are not in the cache: before a process joins, since others wait then."""
    from deploy.run import preload  # noqa: F401, PLC0415


def _check_same(scenario: Scenario, credential: Path) -> None:
    """Raise ScenarioError if a scenario differs from the netshaper's next to the credential; paths may differ."""
    beside = credential.parent / run_directory.SCENARIO
    if not beside.exists():
        return
    theirs, ours = (each.model_dump(exclude={"bus"}) for each in (load(beside, {}), scenario))
    for key, value in ours.items():
        if _without_folders(key, value) != _without_folders(key, theirs[key]):
            raise ScenarioError(
                f"{key} = {value!r} here, but {theirs[key]!r} in {beside}: all processes need the same scenario"
            )


def _map_digest(world_map: Map) -> str:
    """Return the digest of a map, which is the same on all hosts."""
    place = f"{world_map.cells.shape} {world_map.resolution!r} {world_map.origin!r} "
    return hashlib.sha256(place.encode() + world_map.cells.tobytes()).hexdigest()[:16]


def _check_map(plan: Plan, read: Credential) -> None:
    """Raise ScenarioError if the map is not that of the relay: files of one name may differ between hosts."""
    if read.map not in ("", _map_digest(plan.map)):
        raise ScenarioError(
            f"map = {plan.scenario.map}: differs from the map of the relay: copy the same file to all hosts"
        )


def _without_folders(key: str, value: Any) -> Any:
    """Return a setting, paths as names of files."""
    if key == "map":
        return Path(value).name
    return value | {"files": [Path(file).name for file in value["files"]]} if key == "recording" else value


def _credential(path: Path, name: str) -> Credential:
    read = _read(path)
    if read.name != name:
        raise ScenarioError(f"credential {path} is that of {read.name}; {name}.json is needed here")
    return read


def _read(path: Path) -> Credential:
    read = Credential.read(path)
    _check(read, f"credential {path}")
    return read


def _check(read: Credential, where: str) -> None:
    """Raise ScenarioError if a hub would refuse the certificate, or the relay runs other code.

    With other code, messages could be misread, or the digest differ.
    """
    if fault := certificate_fault(read):
        raise ScenarioError(f"{where}: {fault}")
    here = code_digest(STARTERS)
    if read.code not in ("", here):
        raise ScenarioError(
            f"{where}: its relay runs other code of Murmur ({read.code}; here {here}): "
            "install the same version on all hosts"
        )
