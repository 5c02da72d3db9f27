"""`murmur chaos`: run swarms under random faults, each case drawn from a seed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deploy.commands.console import errors, report_user_errors, screen
from deploy.commands.flags import command_family

if TYPE_CHECKING:
    from deploy.chaos.runs import Verdict

app = command_family()


@app.command()
def chaos(
    runs: Annotated[int, typer.Option(min=1, metavar="N", help="number of cases")] = 100,
    seed: Annotated[int, typer.Option(min=0, metavar="S", help="first seed; the others follow")] = 0,
    shrink: Annotated[
        bool,
        typer.Option("--shrink/--no-shrink", help="write a minimal scenario for each failing case"),
    ] = True,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="folder for the scenarios of failing cases")
    ] = Path(),
    verbose: Annotated[bool, typer.Option("--verbose", help="print a line per run")] = False,
) -> None:
    """Run swarms under random kills, restarts, stops, radio failures and byzantine robots; each seed gives a case.

    Every step of a run is checked; after the faults have ended, the remaining robots must finish. One case in ten also
    runs as processes and must give the same digest. For a failing seed, the command that repeats it is printed. Exit
    code 1: a case failed.
    """
    from deploy.chaos import runs as storms  # noqa: PLC0415
    from deploy.study.progress import counting  # noqa: PLC0415

    failed: list[Verdict] = []
    steps, wall_s, again, least = 0, 0.0, 0, 1.0
    with report_user_errors():
        if out.exists() and not out.is_dir():
            raise ValueError(f"out = {out}: not a folder; the scenarios of failing cases go there")
        with counting(errors, "chaos") as tell:
            for done, verdict in enumerate(storms.storms(seed, runs), 1):
                steps, wall_s = steps + verdict.steps, wall_s + verdict.wall_s
                again += verdict.again and not verdict.failure
                if verdict.failure:
                    failed.append(verdict)
                    errors.print(f"seed {verdict.case.seed}: {verdict.failure}")
                    errors.print(f"  repeat: murmur chaos --runs 1 --seed {verdict.case.seed}")
                    if shrink:
                        errors.print(f"  {_write(storms.shrink(verdict), out)}")
                else:
                    least = min(least, verdict.known)
                    if verbose:
                        screen.print(verdict.line)
                tell(done, runs)
        held = runs - len(failed)
        pace = f", {60 * steps / wall_s:.0f} steps per minute" if wall_s else ""
        screen.print(
            f"{held} of {runs} cases passed: {steps} steps{pace}; {again} also ran as processes, with the same digest; "
            f"surviving robots knew at least {100 * least:.1f} %"
        )
    raise typer.Exit(1 if failed else 0)


def _write(verdict: Verdict, folder: Path) -> str:
    """Write a reduced failing case as a scenario; return a line about it."""
    case = verdict.case
    path = folder / f"chaos-{case.seed}.toml"
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(f"# {verdict.failure}\n" + case.scenario.to_toml(), encoding="utf-8")
    byzantine = f", byzantine robots {list(case.byzantine)}" if case.byzantine else ""
    return f"{path}: reduced case with {len(case.scenario.fault)} faults{byzantine}: {verdict.failure}"
