"""`murmur chaos`: run swarms under random faults and check invariants."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deploy.commands.console import errors, screen
from deploy.commands.flags import command_family, option, switch

if TYPE_CHECKING:
    from deploy.chaos.runs import Verdict

app = command_family()


@app.command()
def chaos(
    runs: Annotated[int, option("N", "number of runs", min=1)] = 100,
    seed: Annotated[int, option("S", "seed of the first run", min=0)] = 0,
    shrink: Annotated[
        bool, switch("--shrink/--no-shrink", "reduce failing cases to the faults they need")
    ] = True,
    out: Annotated[Path, option("DIR", "directory for the scenarios of failing cases")] = Path(),
    verbose: Annotated[bool, switch("--verbose", "print a line per run")] = False,
) -> None:
    """Run swarms of real code under kills, restarts, stops, radio faults and byzantine robots, drawn from seeds.

    Each run is checked step by step; after the faults have healed the remaining robots must finish. One of ten runs is
    repeated as processes and must have the same digest. For a failing seed the command prints how to repeat it. Exit
    code 1: a run has failed.
    """
    from deploy.chaos.runs import run_cases  # noqa: PLC0415
    from deploy.chaos.runs import shrink as shrink_case  # noqa: PLC0415
    from deploy.study.progress import counting  # noqa: PLC0415

    failed: list[Verdict] = []
    steps, wall_s, repeated, min_known = 0, 0.0, 0, 1.0
    if out.exists() and not out.is_dir():
        raise ValueError(f"out = {out}: is a file; name a directory for the scenarios of failing cases")
    with counting(errors, "chaos") as progress:
        for done, verdict in enumerate(run_cases(seed, runs), 1):
            steps, wall_s = steps + verdict.steps, wall_s + verdict.wall_s
            repeated += verdict.as_processes and not verdict.failure
            if verdict.failure:
                failed.append(verdict)
                errors.print(f"seed {verdict.case.seed}: {verdict.failure}")
                errors.print(f"  repeat: murmur chaos --runs 1 --seed {verdict.case.seed}")
                if shrink:
                    errors.print(f"  {_write(shrink_case(verdict), out)}")
            else:
                min_known = min(min_known, verdict.known)
                if verbose:
                    screen.print(verdict.line)
            progress(done, runs)
    pace = f" at {60 * steps / wall_s:.0f} steps per minute" if wall_s else ""
    screen.print(
        f"{runs - len(failed)} of {runs} runs passed: {steps} steps{pace}; {repeated} repeated as processes with "
        f"the same digest; living robots knew at least {100 * min_known:.1f} % of the map"
    )
    raise typer.Exit(1 if failed else 0)


def _write(verdict: Verdict, folder: Path) -> str:
    """Write the smallest failing case as a scenario; return a description."""
    case = verdict.case
    path = folder / f"chaos-{case.seed}.toml"
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(f"# {verdict.failure}\n" + case.scenario.to_toml(), encoding="utf-8")
    byzantine = f" and byzantine robots {list(case.byzantine)}" if case.byzantine else ""
    return f"smallest failing case: {path}, {len(case.scenario.fault)} faults{byzantine}: {verdict.failure}"
