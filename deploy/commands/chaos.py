"""`murmur chaos`: swarms under faults that are drawn from seeds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deploy.commands.console import errors, report_user_errors, screen
from deploy.commands.flags import family

if TYPE_CHECKING:
    from deploy.chaos.runs import Verdict

app = family()


@app.command()
def chaos(
    runs: Annotated[int, typer.Option(min=1, metavar="N", help="how many storms")] = 100,
    seed: Annotated[int, typer.Option(min=0, metavar="S", help="seed of the first; the others follow")] = 0,
    shrink: Annotated[
        bool, typer.Option("--shrink/--no-shrink", help="find out what a failure needs, and write it down")
    ] = True,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="where the scenarios of failures are written")
    ] = Path(),
    verbose: Annotated[bool, typer.Option("--verbose", help="a line a run")] = False,
) -> None:
    """Run swarms of real code under kills, restarts, stops, failing radios and liars, all drawn from a seed each.

    Each run is checked step by step; once faults have healed the rest must finish. One of ten runs again as processes,
    and must have the same digest. A seed that fails is printed with the command that repeats it. Exit code 1: one has
    failed.
    """
    from deploy.chaos import runs as storms  # noqa: PLC0415
    from deploy.study.progress import counting  # noqa: PLC0415

    failed: list[Verdict] = []
    steps, wall_s, again, least = 0, 0.0, 0, 1.0
    with report_user_errors():
        if out.exists() and not out.is_dir():
            raise ValueError(f"out = {out}: is a file; name a folder for the scenarios of failures")
        with counting(errors, "chaos") as tell:
            for done, verdict in enumerate(storms.storms(seed, runs), 1):
                steps, wall_s = steps + verdict.steps, wall_s + verdict.wall_s
                again += verdict.again and not verdict.failure
                if verdict.failure:
                    failed.append(verdict)
                    errors.print(f"seed {verdict.case.seed}: {verdict.failure}")
                    errors.print(f"  again: murmur chaos --runs 1 --seed {verdict.case.seed}")
                    if shrink:
                        errors.print(f"  {_write(storms.shrink(verdict), out)}")
                else:
                    least = min(least, verdict.known)
                    if verbose:
                        screen.print(verdict.line)
                tell(done, runs)
        held = runs - len(failed)
        pace = f", {60 * steps / wall_s:.0f} steps a minute" if wall_s else ""
        screen.print(
            f"{held} of {runs} storms hold: {steps} steps{pace}; {again} of them again as processes, with the same "
            f"digest; those who lived knew {100 * least:.1f} % or more"
        )
    raise typer.Exit(1 if failed else 0)


def _write(verdict: Verdict, folder: Path) -> str:
    """Write the smallest storm that fails as a scenario; say where it is, and what is in it."""
    case = verdict.case
    path = folder / f"chaos-{case.seed}.toml"
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(f"# {verdict.failure}\n" + case.scenario.to_toml(), encoding="utf-8")
    byzantine = f", and liars {list(case.byzantine)}" if case.byzantine else ""
    return f"{path} has what it takes: {len(case.scenario.fault)} faults{byzantine}: {verdict.failure}"
