"""Run the code blocks of README and docs by the rules of docs/contributing.md, and the notebooks.

Slow blocks are only parsed here; `test_every_block_of_a_page_runs` (``-m long``) runs them.
"""

from __future__ import annotations

import ast
import gc
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

import nbclient
import nbformat
import pytest
import typer
from typer._click.exceptions import UsageError

from deploy.commands.app import app
from murmur import __all__ as public_names
from tests.deploy.commands.office_floor import murmur

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
RESULTS = ROOT / "docs" / "results"
"""Pages of measurements, whose commands take hours; `docs.figures` repeats them."""
BLOCK = re.compile(r"(?:<!-- ([^\n]*?) -->\n)?^([ ]*)```([^\n]*)\n(.*?)^[ ]*```$", re.M | re.S)
LANGUAGES = {"", "sh", "console", "python", "toml"}
PLACEHOLDERS = {"HOST", "N"}
"""Placeholders for values that no parser can read."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    rule: str
    language: str
    text: str


def blocks(page: Path) -> list[Block]:
    found = BLOCK.findall(page.read_text(encoding="utf-8"))
    return [Block(rule, language, text) for rule, _, language, text in found]


def lines(block: Block) -> list[str]:
    """Return the commands of a block without comments and prompts; continued lines are joined."""
    text = re.sub(r"(^|\s+)# .*$", "", block.text.replace("\\\n", " "), flags=re.M)
    plain = [line.strip().removeprefix("$ ").removeprefix(".venv/bin/") for line in text.splitlines()]
    return [part.strip() for line in plain for part in re.split(r"\s[;&]\s|;\s", line) if part.strip()]


def commands(block: Block) -> dict[str, list[str]]:
    """Return the commands of a terminal block, each with its output on the page."""
    if block.language not in ("", "sh", "console") or block.rule.startswith(("output", "drawing", "file")):
        return {}
    prompted = re.findall(r"^ *\$ (.*)\n((?:(?! *\$ ).*\n)*)", block.text, re.M)
    if not prompted:
        return {line: [] for line in lines(block)}
    return {lines(Block("", "", line))[0]: printed.splitlines() for line, printed in prompted}


GIVEN = {
    "building.yaml": "murmur map make em --out building.yaml",
    "flat.png": "murmur map make em --out flat.yaml",
    "DIR": "murmur explore --map em --robots 2 --steps 30 --bus memory --out DIR",
}
"""Files that exist before a page runs, each with the command that makes it."""

SMALLER = {
    "strategies meier,repairmen --map office-plain --seeds 5": "strategies meier,repairmen --map em --seeds 2",
    "size --map office-plain --robots 2..4": "size --map em --robots 2..3 --bandwidth 1000 --range 30% --seeds 1",
    "murmur reproduce --quick": "murmur reproduce --quick A1 --seeds 1",
    "murmur sweep lossy.toml": "murmur sweep lossy.toml --quick --seeds 1",
    "seeds=10)": "seeds=2)",
    "robots=range(2, 9), deadline=300,": "robots=[2], seeds=1, deadline=300,",
    "tune repairmen --evaluations 20": "tune repairmen --evaluations 2 --maps maze --seeds 0 --check-seeds 1",
    "--maps caves,warehouse --seeds 0..4 --check-seeds 5..9": "--maps em --seeds 0 --check-seeds 1 --evaluations 2",
}
"""Parts of blocks that take minutes, each with a smaller one."""

RELAY = "murmur run netshaper hand.toml --listen"
NOT_RUN = {
    # They change the tree under test, or need a public address.
    "make demo",
    "make test",
    "make setup",
    ". .venv/bin/activate",
    "pip install 'murmur-robots[view]'",
    # See test_packaging.py.
    "pip install build",
    "python -m build",
    "pip install --constraint constraints.txt murmur_robots-0.2.0-py3-none-any.whl",
    "podman build --tag murmur .",
    'podman run --rm --volume "$PWD/runs:/work/runs" murmur explore --robots 5',
    # They need logs of real robots.
    "murmur play my.log.gz --robots 8",
    "murmur play my.log.gz --robots 8 --bandwidth 50",
    "murmur play my.log.gz --robots 8 --bandwidth 50 --pace recorded",
    "murmur play first.bag second.bag --radio lora-sf7 --view",
    # It opens a window; the test runs tshark instead.
    "wireshark office/radio.pcapng",
    # They run until Ctrl-C; see tests/system/test_serve_ros2.py.
    "murmur serve-ros2 --map office --robots 3",
    "murmur serve-ros2 --robots 3 --laser rplidar-a1 --pose graph-slam --people 4 --names ada,bob,eve",
    # They need other hosts; see tests/system/test_hosts.py.
    "murmur explore --robots 4 --hosts hosts.toml",
    "murmur run agent --credential r1.json",
    f"{RELAY} 192.168.1.10:7447 --keys keys",
    f"{RELAY} 192.168.1.10:7447 --credentials credentials",
    f"{RELAY} 192.168.1.10:7447 --credentials credentials --keys keys",
    # They need a ROS 2 robot; see tests/deploy/field/test_robot_process.py.
    "pip install 'murmur-robots[ros2]'",
    "ros2 run rmw_zenoh_cpp rmw_zenohd",
    "murmur doctor --ros2 robot.toml",
    "murmur robot robot.toml",
    "murmur stop record",
    "murmur stop --all",
    "murmur serve-ros2 --map office --robots 2 --write-robots dry-run",
    "murmur robot dry-run/r0.toml",
    "murmur robot dry-run/r1.toml",
    "murmur serve-ros2 --map building.yaml --robots 2 --team 3 --interface wlan0 --write-robots half",
    "murmur robot half/r0.toml",
    "murmur robot half/r1.toml",
    "murmur merge r0/record r1/record r2/record --out team",
    "murmur report team",
    # They need five terminals; see tests/system/test_by_hand.py.
    f"{RELAY} 127.0.0.1:7447 --credentials credentials",
    "murmur run worldsim hand.toml --credential credentials/world.json",
    "murmur run agent --credential credentials/r0.json",
    "murmur run agent --credential credentials/r1.json",
    "murmur run recorder hand.toml --credential credentials/recorder.json --out by-hand",
}
"""Lines that are never run."""


def calls(page: Path) -> list[str]:
    """Return all lines of a page that call murmur."""
    return [
        line
        for block in blocks(page)
        if block.language in ("", "sh", "console") and block.rule != "output"
        for line in lines(block)
        if re.match(r"murmur [a-z-]", line)
    ]


def read(line: str) -> None:
    """Parse a line with the command line's own parser, without running it."""
    arguments = shlex.split(line, comments=True)[1:]
    for sign in ("|", ">", "2>", "<", "&"):
        arguments = arguments[: arguments.index(sign)] if sign in arguments else arguments
    command = typer.main.get_command(app)
    context = command.make_context("murmur", list(arguments))
    while hasattr(command, "resolve_command"):
        name, command, rest = command.resolve_command(context, [*context._protected_args, *context.args])
        assert command is not None, f"{line}: there is no command {name}"
        context = command.make_context(name, list(rest), parent=context)


CALLS = {f"{page.relative_to(ROOT)}: {line}": line for page in PAGES for line in calls(page)}


@pytest.mark.parametrize("line", CALLS.values(), ids=list(CALLS))
def test_the_command_line_accepts_each_line_that_calls_murmur(line: str) -> None:
    if not PLACEHOLDERS & set(line.split()):
        read(line)


def test_an_invalid_line_is_found() -> None:
    for wrong in ("murmur explre", "murmur explore --robts 3", "murmur explore --robots three"):
        with pytest.raises(UsageError):
            read(wrong)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_blocks_of_a_page_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    printed = ""
    for block in blocks(page):
        rule, _, name = block.rule.partition(" ")
        if rule == "file":
            Path(name).write_text(block.text, encoding="utf-8")
        before, printed = printed, ""
        if rule == "run":
            for line, expected in commands(block).items():
                printed = run(line)
                holds(printed, expected)
        elif rule == "output" and before:
            holds(before, block.text.splitlines())
        elif block.language == "toml":
            tomllib.loads(block.text)
        elif block.language == "python" and rule == "part":
            ast.parse("def choose():\n" + block.text)
        elif block.language == "python" and rule in ("file", "parse"):
            ast.parse(block.text)
        elif block.language == "python":
            exec(compile(block.text, str(page), "exec"), names)
        else:
            assert rule in ("", "output", "drawing"), f"{page.name}: there is no rule {block.rule!r}"
    names.clear()
    gc.collect()  # removes strategies that a page defines


def test_no_page_has_a_placeholder() -> None:
    for page in PAGES:
        text = BLOCK.sub("", page.read_text(encoding="utf-8"))
        assert re.findall(r"^[A-Z]{4,}$|\bTODO\b|\bTBD\b", text, re.M) == [], page.name


def test_lines_in_the_rules_are_on_a_page() -> None:
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    on_pages = {line for page in PAGES for block in blocks(page) for line in commands(block)}
    on_pages |= {block.text.splitlines()[0] for page in PAGES for block in blocks(page) if block.text}
    assert [name for name in (*GIVEN, *SMALLER) if name not in text] == []
    assert [line for line in NOT_RUN if line not in on_pages] == []


@pytest.mark.long
@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if RESULTS not in page.parents],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_every_block_of_a_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run everything with real processes, and compare the output with the page."""
    tools, folder = tmp_path / "bin", tmp_path / "page"
    for place in (tools, folder):
        place.mkdir()
    for name, module in (("murmur", " -m deploy.commands.main"), ("python", "")):
        (tools / name).write_text(f'#!/bin/sh\nexec {sys.executable}{module} "$@"\n')
        (tools / name).chmod(0o755)
    monkeypatch.chdir(folder)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("PATH", f"{tools}{os.pathsep}{os.environ['PATH']}")
    text = page.read_text(encoding="utf-8")
    for name, command in GIVEN.items():
        if name in text:
            do(command, [])
    names: dict[str, object] = {}
    printed = ""
    for block in blocks(page):
        rule, _, name = block.rule.partition(" ")
        if rule == "file":
            Path(name).write_text(block.text, encoding="utf-8")
        elif rule == "output":
            holds(printed, block.text.splitlines())
        elif block.language == "python" and rule != "part":
            if block.text.splitlines()[0] not in NOT_RUN:
                exec(compile(smaller(block.text), str(page), "exec"), names)
        else:
            for line, expected in commands(block).items():
                if line not in NOT_RUN:
                    printed = do(line, expected)
    names.clear()
    gc.collect()


def smaller(text: str) -> str:
    for whole, part in SMALLER.items():
        text = text.replace(whole, part)
    return text


def do(line: str, expected: list[str]) -> str:
    """Run a line in the shell; exit code 1 means an unfinished exploration or a failed claim."""
    tool = shlex.split(line)[0]
    if shutil.which(tool) is None:
        pytest.skip(f"{tool} is not installed")
    done = subprocess.run(smaller(line), shell=True, capture_output=True, text=True, check=False)
    allowed = (0, 1) if line.startswith(("murmur explore", "murmur reproduce")) else (0,)
    assert done.returncode in allowed, f"{line}: {done.stdout}{done.stderr}"
    holds(done.stdout, expected)
    return done.stdout


def holds(printed: str, expected: list[str]) -> None:
    """Check that each line is printed, except for times, omissions, and column widths."""
    lines_printed = {" ".join(line.split()) for line in printed.splitlines()}
    for line in expected:
        if line and "..." not in line and "steps/s on the" not in line:
            assert " ".join(line.split()) in lines_printed, f"not printed: {line}\n{printed}"


def run(line: str) -> str:
    """Run a line on the memory bus; return its output."""
    arguments = shlex.split(line, comments=True)
    if arguments[0] == "murmur":
        on_bus = ["--bus", "memory"] if arguments[1] == "explore" else []
        result = murmur(*arguments[1:], *on_bus)
        assert result.exit_code in (0, 1), f"{line}: {result.stderr}"
        return result.stdout
    assert arguments[0] == "python", f"{line}: neither murmur nor python"
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, *arguments[1:]], capture_output=True, text=True, env=env, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_notebooks_run() -> None:
    """All notebooks run in one kernel, reset after each: starting a kernel takes longer than a notebook."""
    books = [
        nbformat.read(path, nbformat.NO_CONVERT)  # type: ignore[no-untyped-call]
        for path in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
    ]
    assert len(books) == 3
    assert not [cell for book in books for cell in book.cells if cell.get("outputs")], "kept without outputs"
    reset = "%reset -f"
    cells = [cell for book in books for cell in [*book.cells, nbformat.v4.new_code_cell(reset)]]
    for number, cell in enumerate(cells):
        cell.id = f"cell-{number}"
    all_of_them = nbformat.v4.new_notebook(cells=cells)  # type: ignore[no-untyped-call]
    os.environ.setdefault("PYTHONPATH", str(ROOT))
    nbclient.NotebookClient(all_of_them, timeout=300, kernel_name="python3").execute()
    outputs = [output for cell in all_of_them.cells for output in cell.get("outputs", [])]
    printed = "".join(output.get("text", "") for output in outputs)
    assert re.search(r"RuntimeError: no target\n.*after <step \d+: .*> raised: no target", printed, re.DOTALL)


def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--quiet",
        "--site-dir",
        str(tmp_path / "site"),
    ]
    env = os.environ | {"NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=env, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    pages = list((tmp_path / "site").rglob("*.html"))
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    assert "known_cells" in text, "columns of files are made from code"
    for name in public_names:
        assert f".{name}" in text, f"{name} is in no reference"
    loaded = re.findall(r'<(?:script|link|img)[^>]*(?:src|href)="(https?:[^"]*)"', text)
    assert not loaded, "the site needs no network"
