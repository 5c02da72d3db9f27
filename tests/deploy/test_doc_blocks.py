"""Every block of README and docs is run or read, by the rules of docs/contributing.md; notebooks are run."""

from __future__ import annotations

import ast
import gc
import os
import re
import shlex
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

import deploy
from deploy.commands.main import app
from tests.deploy.commands.office_floor import murmur

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"(?:<!-- ([^\n]*?) -->\n)?^([ ]*)```([^\n]*)\n(.*?)^[ ]*```$", re.M | re.S)
LANGUAGES = {"", "sh", "console", "python", "toml"}
PLACEHOLDERS = {"HOST", "N"}
"""Words of documents that stand for a value which no parser can read."""


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
    """The commands of a block, their comments taken off, prompts too; lines that go on are joined."""
    text = block.text.replace("\\\n", " ")
    said = [line.strip().removeprefix("$ ").removeprefix(".venv/bin/") for line in text.splitlines()]
    return [part.strip() for line in said for part in re.split(r"\s[;&]\s|;\s", line) if part.strip()]


def calls(page: Path) -> list[str]:
    """All lines of a page that call murmur."""
    return [
        line
        for block in blocks(page)
        if block.language in ("", "sh", "console") and block.rule != "output"
        for line in lines(block)
        if re.match(r"murmur [a-z-]", line)
    ]


def read(line: str) -> None:
    """Let the command line's own parser read a line, without doing what it says."""
    words = shlex.split(line, comments=True)[1:]
    for sign in ("|", ">", "2>", "<", "&"):
        words = words[: words.index(sign)] if sign in words else words
    command = typer.main.get_command(app)
    context = command.make_context("murmur", list(words))
    while hasattr(command, "resolve_command"):
        name, command, rest = command.resolve_command(context, [*context._protected_args, *context.args])
        assert command is not None, f"{line}: there is no command {name}"
        context = command.make_context(name, list(rest), parent=context)


CALLS = {f"{page.relative_to(ROOT)}: {line}": line for page in PAGES for line in calls(page)}


@pytest.mark.parametrize("line", CALLS.values(), ids=list(CALLS))
def test_each_line_that_calls_murmur_is_one_that_it_understands(line: str) -> None:
    if not PLACEHOLDERS & set(line.split()):
        read(line)


def test_a_line_that_murmur_does_not_understand_is_found() -> None:
    for wrong in ("murmur explre", "murmur explore --robts 3", "murmur explore --robots three"):
        with pytest.raises(UsageError):
            read(wrong)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_blocks_of_a_page_do_what_they_say(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in blocks(page):
        rule, _, name = block.rule.partition(" ")
        if rule == "file":
            Path(name).write_text(block.text, encoding="utf-8")
        if rule == "run":
            for line in lines(block):
                run(line)
        elif block.language == "toml":
            tomllib.loads(block.text)
        elif block.language == "python" and rule == "part":
            ast.parse("def choose():\n" + block.text)
        elif block.language == "python" and rule in ("file", "parse"):
            ast.parse(block.text)
        elif block.language == "python":
            exec(compile(block.text, str(page), "exec"), names)
        else:
            assert rule in ("", "shell", "output"), f"{page.name}: there is no rule {block.rule!r}"
    names.clear()
    gc.collect()  # strategies that a page defines are not there for other tests


def run(line: str) -> None:
    """Run a line as it stands, on the bus in memory."""
    words = shlex.split(line, comments=True)
    if words[0] == "murmur":
        on_bus = ["--bus", "memory"] if words[1] == "explore" else []
        result = murmur(*words[1:], *on_bus)
        assert result.exit_code in (0, 1), f"{line}: {result.stderr}"
        return
    assert words[0] == "python", f"{line}: neither murmur nor python"
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, *words[1:]], capture_output=True, text=True, env=env, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_notebooks_run() -> None:
    """In one kernel, whose names are taken away after each: starting one takes longer than what they do."""
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
    for name in deploy.__all__:
        assert f".{name}" in text, f"{name} is in no reference"
    loaded = re.findall(r'<(?:script|link|img)[^>]*(?:src|href)="(https?:[^"]*)"', text)
    assert not loaded, "the site needs no network"
