"""`murmur bench`: measure the speed of this machine, and compare strategies."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

from deploy.commands.console import errors, screen
from deploy.commands.flag_values import named_values
from deploy.commands.flags import JsonFlag, argument, command_family, file_option, option
from deploy.scenario.tables import MAX_RUNS

app = command_family()

LEAGUE_SEEDS = 3


@app.command()
def bench(
    names: Annotated[
        list[str] | None,
        argument(
            "NAME...",
            "kernels, swarm, replanning, relay, scale, field; default: all of these. "
            "Or strategies: the league table; or peers: the rules of other simulators",
        ),
    ] = None,
    robots: Annotated[
        list[int] | None, option("N", "team size for `scale` and `strategies`; repeatable", min=1, max=256)
    ] = None,
    maps: Annotated[
        list[str] | None,
        option("FILE|NAME", "a map for `strategies` (default office); repeatable", name="--map"),
    ] = None,
    strategies: Annotated[
        list[str] | None,
        option(
            "NAME",
            "for `strategies` (default: all) and `scale` (default: meier); repeatable",
            name="--strategy",
        ),
    ] = None,
    seeds: Annotated[
        int | None, option("N", "seeds per map and team of `strategies` (default 3)", min=1, max=MAX_RUNS)
    ] = None,
    settings: Annotated[
        list[str] | None,
        option("KEY=VALUE", "a setting of all runs of `strategies`; repeatable", name="--set"),
    ] = None,
    picture: Annotated[Path | None, file_option("FILE.png", "draw the league table of `strategies`")] = None,
    jobs: Annotated[
        int | None, option("N", "processes for `strategies` (default: one per core)", min=1)
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Benchmark this machine: each value as a ratio to a baseline measured in the same run.

    `murmur bench strategies` prints the league table: all strategies on the same maps, from the same starts, as
    multiples of the steps of a plan that knows the map (docs/results/strategies.md). `murmur bench peers` takes
    minutes: strategies by the rules of other simulators (docs/peers.md).
    """
    if names == ["strategies"]:
        values = named_values(settings or [], "set", "bandwidth=1000")
        _league(maps, robots, seeds or LEAGUE_SEEDS, strategies, values, picture, jobs, as_json=as_json)
        return
    from deploy.bench.registry import run_benchmarks  # noqa: PLC0415

    _refuse_options(
        names or [],
        scale={"robots": robots, "strategy": strategies},
        league={"map": maps, "seeds": seeds, "set": settings, "picture": picture, "jobs": jobs},
    )
    report = (lambda _: None) if as_json else screen.print
    figures = run_benchmarks(names or [], report, robots or [], strategies or [])
    if as_json:
        print(json.dumps(figures, indent=2))


def _refuse_options(names: list[str], scale: dict[str, object], league: dict[str, object]) -> None:
    """Raise ValueError if an option of ``scale`` or of the league table is given that has no effect on benchmarks."""
    without_effect = league if not names or "scale" in names else league | scale
    for flag, value in without_effect.items():
        if value is not None:
            raise ValueError(f"--{flag} has no effect on {', '.join(names or ['these benchmarks'])}")


def _league(
    maps: list[str] | None,
    robots: list[int] | None,
    seeds: int,
    strategies: list[str] | None,
    settings: dict[str, Any],
    picture: Path | None,
    jobs: int | None,
    *,
    as_json: bool,
) -> None:
    from deploy.bench import league  # noqa: PLC0415
    from deploy.commands.study_output import print_table  # noqa: PLC0415
    from deploy.study.progress import counting  # noqa: PLC0415

    tasks = league.tasks(maps or ["office"], robots or [6], seeds, strategies or [], settings)
    runs: list[league.Run] = []
    with counting(errors, "strategies") as tell:
        for done, found in enumerate(league.compete(tasks, jobs), 1):
            runs += found
            tell(done, len(tasks))
    standings = league.table(runs)
    if picture is not None:
        league.draw(standings, picture)
    if as_json:
        print(standings.write_json())
    else:
        print_table(league.lines(standings))
