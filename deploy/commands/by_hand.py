"""`murmur run`: start one process of a run (docs/several-terminals.md)."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from deploy.commands.console import errors, progress, report_result, screen
from deploy.commands.flag_values import named_values
from deploy.commands.flags import JsonFlag, OutOption, ViewAs, argument, command_family, option, subcommands
from deploy.scenario.scenario import load
from protocol.files import exposure

app = command_family()
run_app = subcommands(app, "run", "Start one process of a run by hand (see docs/several-terminals.md).")

ScenarioOfRun = Annotated[
    Path | None, argument("SCENARIO.toml", "the scenario file, the same for all processes of a run")
]


@run_app.command("netshaper")
def run_netshaper(
    scenario: ScenarioOfRun = None,
    listen: Annotated[str, option("HOST:PORT", "address of the hub")] = "127.0.0.1:7447",
    credentials: Annotated[
        Path, option("DIR", "new directory for the credential files, one per participant")
    ] = Path("credentials"),
    keys: Annotated[
        Path | None, option("DIR", "certificates of murmur keys: mutual TLS instead of passwords")
    ] = None,
) -> None:
    """Start the radio relay and hub, which all other processes join; it writes their credentials."""
    from deploy.run.by_hand import serve_netshaper  # noqa: PLC0415

    _warn_of_exposed(sorted(keys.glob("*.key")) if keys is not None else [])
    serve_netshaper(load(scenario, {}), listen, credentials, screen.print, keys)


@run_app.command("worldsim")
def run_worldsim(
    credential: Annotated[Path, option("FILE", "world.json of the netshaper's credentials")],
    scenario: ScenarioOfRun = None,
) -> None:
    """Start the world simulator, with the map and the clock; the run begins when all processes have joined."""
    from deploy.run.by_hand import serve_worldsim  # noqa: PLC0415

    _warn_of_exposed([credential])
    serve_worldsim(load(scenario, {}), credential)


@run_app.command("agent")
def run_agent(
    credential: Annotated[Path, option("FILE", "rN.json of the netshaper's credentials; -: standard input")],
) -> None:
    """Start one robot; it receives its settings over the bus."""
    from deploy.run.by_hand import serve_robot  # noqa: PLC0415

    _warn_of_exposed([credential])
    serve_robot(credential)


@run_app.command("agents")
def run_agents(
    plugin: Annotated[list[str] | None, option("SETTING=NAME", "a plug-in that the robots need")] = None,
) -> None:
    """Start robots for `murmur explore --hosts` on another host; it uses standard input and output."""
    from deploy.run.remote_agents import serve  # noqa: PLC0415

    serve({key: str(name) for key, name in named_values(plugin or [], "plugin", "strategy=my:Mine").items()})


@run_app.command("router")
def run_router(
    credential: Annotated[Path, option("FILE", "router@NAME.json of the netshaper's credentials")],
    listen: Annotated[str, option("HOST:PORT", "address of the router")] = "127.0.0.1:7448",
    credentials: Annotated[
        Path, option("DIR", "new directory for the credential files of its robots")
    ] = Path("routed"),
) -> None:
    """Start a router, whose robots share one connection to the hub (docs/hosts.md)."""
    from deploy.run.by_hand import serve_routing  # noqa: PLC0415

    _warn_of_exposed([credential])
    serve_routing(credential, listen, credentials, screen.print)


@run_app.command("view")
def run_view(
    credential: Annotated[Path, option("FILE", "view.json of the netshaper's credentials")],
    scenario: ScenarioOfRun = None,
    out: Annotated[Path, option("DIR", "directory for the recording")] = Path(),
    view_as: ViewAs = "auto",
) -> None:
    """Start a viewer; it may join and leave at any time."""
    from deploy.dashboard.windows import Window  # noqa: PLC0415
    from deploy.run.by_hand import serve_viewer  # noqa: PLC0415

    _warn_of_exposed([credential])
    with closing(Window(view_as, errors.print)) as window:
        serve_viewer(load(scenario, {}), credential, out, window)


@run_app.command("recorder")
def run_recorder(
    credential: Annotated[Path, option("FILE", "recorder.json of the netshaper's credentials")],
    scenario: ScenarioOfRun = None,
    out: OutOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Start the recorder, which writes the run directory at the end."""
    from deploy.run.by_hand import serve_recorder  # noqa: PLC0415

    _warn_of_exposed([credential])
    with progress(shown=not as_json) as watch:
        result = serve_recorder(load(scenario, {}), credential, out, watch, errors.print)
    raise typer.Exit(report_result(result, as_json=as_json))


def _warn_of_exposed(secrets: Sequence[Path]) -> None:
    """Warn of private keys and credentials with which other users could join in the name of a participant."""
    exposed = [text for path in secrets if (text := exposure(path))]
    if exposed:
        others = f"; the same holds for {len(exposed) - 1} more files there" if exposed[1:] else ""
        errors.print(f"warning: {exposed[0]}{others}")
