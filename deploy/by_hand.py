"""Processes started by hand, each in a terminal or on a host of its own (docs/several-terminals.md)."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from pathlib import Path

from deploy import plan as plans
from deploy import rundir
from deploy.dashboard.process import ViewTask, serve
from deploy.dashboard.windows import Window
from deploy.launch import Outcome, interrupts
from deploy.mission import Result, conclude
from deploy.plan import Plan
from deploy.processes import WorldTask, serve_agent, serve_relay, serve_world
from deploy.records import LabNode, Records
from deploy.scenario import Scenario, ScenarioError, load
from deploy.wire import Meter
from netshaper import access
from protocol import keys as names
from protocol.bus import BusClosed
from protocol.keys import Keys
from protocol.zenoh_bus import Credential, join

SCENARIO = "scenario.toml"
"""Lies beside the credentials: what the netshaper was given, for the others to compare theirs with."""


def serve_netshaper(scenario: Scenario, listen: str, folder: Path, tell: Callable[[str], object]) -> None:
    """Write credentials for a new run into `folder`, then be its hub and relay."""
    plan = plans.make(scenario)
    host, _, port = listen.rpartition(":")
    if not host or not port.isdecimal():
        raise ScenarioError(f"listen = {listen!r}: must be HOST:PORT, as 127.0.0.1:7447")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ScenarioError(f"credentials = {folder}: it exists already; name a new directory")
    folder.mkdir(parents=True, exist_ok=True)
    endpoint = f"tcp/{listen}"
    run = secrets.token_hex(4)
    credentials = access.issue(run, endpoint, scenario.robots)
    for name, credential in credentials.items():
        credential.write(folder / f"{name}.json")
    (folder / SCENARIO).write_text(scenario.to_toml(), encoding="utf-8")
    tell(f"run {run} at {endpoint}; credentials in {folder}: {', '.join(credentials)}")
    serve_relay(run, endpoint, credentials, plan.radio, tell)


def serve_worldsim(scenario: Scenario, credential: Path) -> None:
    """Be the world of the run that the credential belongs to."""
    _check_same(scenario, credential)
    plan = plans.make(scenario)
    task = WorldTask(plan.make_world(), plan.minds, scenario.steps, 1000 * plan.map.resolution)
    serve_world(_credential(credential, names.WORLD), task)


def serve_robot(credential: Path) -> None:
    """Be the robot that the credential names."""
    read = Credential.read(credential)
    names.number(read.name)
    serve_agent(read)


def serve_lab(
    scenario: Scenario,
    credential: Path,
    out: Path | None,
    watch: Callable[[Plan, Records], object] | None,
) -> Result:
    """Be the laboratory: record the run and write its directory."""
    _check_same(scenario, credential)
    plan = plans.make(scenario)
    read = _credential(credential, names.LAB)
    directory = rundir.create(out, plan)
    began = time.perf_counter()
    deaths: dict[str, str] = {}
    bus = join(read)
    with rundir.open_capture(directory, plan) as capture, interrupts() as interrupted:
        lab = LabNode(bus, Keys(read.run), scenario.robots, capture, Meter(read.hub))
        asked_to_stop = False
        try:
            while not lab.done:
                message = bus.receive(0.25)
                if message is not None:
                    lab.handle(message)
                if watch is not None:
                    watch(plan, lab.records)
                if interrupted and not asked_to_stop:
                    asked_to_stop = True
                    lab.stop("interrupted")
                if len(interrupted) > 1 or (interrupted and not lab.records.world):
                    lab.send_home()
        except BusClosed as error:
            deaths[names.RELAY] = str(error)
        finally:
            bus.close()
    return conclude(plan, Outcome(lab.records, deaths), directory, time.perf_counter() - began)


def serve_viewer(scenario: Scenario, credential: Path, out: Path, window: Window) -> None:
    """Watch a run and record it into `out`, from now on until it is over."""
    _check_same(scenario, credential)
    out.mkdir(parents=True, exist_ok=True)
    task = ViewTask(plans.make(scenario), out, port=window.port)
    serve(_credential(credential, names.VIEW), task, window.open)


def _check_same(scenario: Scenario, credential: Path) -> None:
    """Refuse a scenario that is not the netshaper's, if that lies beside the credential; paths may differ."""
    beside = credential.parent / SCENARIO
    if not beside.exists():
        return
    theirs, ours = (each.model_dump(exclude={"bus"}) for each in (load(beside, {}), scenario))
    for key, value in ours.items():
        differs = Path(value).name != Path(theirs[key]).name if key == "map" else value != theirs[key]
        if differs:
            raise ScenarioError(f"{key} = {value!r} here, but {theirs[key]!r} in {beside}: give all the same")


def _credential(path: Path, name: str) -> Credential:
    read = Credential.read(path)
    if read.name != name:
        raise ScenarioError(f"credential {path} is that of {read.name}; {name}.json is needed here")
    return read
