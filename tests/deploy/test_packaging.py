"""The package as users install it: wheel, sdist, and container file."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import tarfile
import tomllib
import venv
from pathlib import Path
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).parents[2]
CONTAINER = (ROOT / "Containerfile").read_text(encoding="utf-8").replace("\\\n", " ")
INSTRUCTIONS = {"FROM", "WORKDIR", "COPY", "RUN", "ENV", "ENTRYPOINT", "CMD"}
"""Those that the container file may use."""
PACKAGES = ("agent", "deploy", "murmur", "netshaper", "protocol", "worldsim")


def run(*command: str | Path, cwd: Path, **more: str) -> subprocess.CompletedProcess[str]:
    """Run a command without this repository on Python's path."""
    env = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "NUMBA_"))}
    done = subprocess.run(command, cwd=cwd, env=env | more, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def sources() -> set[str]:
    """Return the files of all packages that are under version control."""
    if not (ROOT / ".git").exists() or shutil.which("git") is None:
        pytest.skip("this is no working tree of git")
    listed = run("git", "ls-files", "--cached", "--others", "--exclude-standard", *PACKAGES, cwd=ROOT).stdout
    return {name for name in listed.splitlines() if (ROOT / name).exists()}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with an sdist, and the wheel that was built from it."""
    folder = tmp_path_factory.mktemp("package")
    tree = folder / "tree"
    for name in (*sources(), "pyproject.toml", "README.md", "LICENSE"):
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, tree / name)
    venv.create(folder / "tools", with_pip=True)
    python = folder / "tools" / "bin" / "python"
    run(python, "-m", "pip", "install", "--quiet", "build", cwd=folder)
    run(python, "-m", "build", "--outdir", folder / "dist", tree, cwd=folder)
    return folder / "dist"


@pytest.mark.long
def test_wheel_and_sdist_contain_exactly_the_packages_with_their_data(built: Path) -> None:
    (wheel,), (sdist,) = built.glob("*.whl"), built.glob("*.tar.gz")
    in_wheel = {name for name in ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert in_wheel == sources()
    with tarfile.open(sdist) as file:
        names = {name.partition("/")[2] for name in file.getnames() if file.getmember(name).isfile()}
    made = {"PKG-INFO", "setup.cfg", "pyproject.toml", "README.md", "LICENSE"}
    assert {name for name in names if not name.startswith("murmur_robots.egg-info/")} == sources() | made


@pytest.mark.long
def test_wheel_and_sdist_install_into_an_empty_environment_and_run(built: Path, tmp_path: Path) -> None:
    """This downloads all dependencies, and compiles all kernels."""
    (wheel,), (sdist,) = built.glob("*.whl"), built.glob("*.tar.gz")
    venv.create(tmp_path / "venv", with_pip=True)
    binaries, elsewhere = tmp_path / "venv" / "bin", tmp_path / "elsewhere"
    elsewhere.mkdir()
    pip = (binaries / "python", "-m", "pip", "install", "--quiet", "--constraint", ROOT / "constraints.txt")
    run(*pip, wheel, cwd=elsewhere)
    murmur = binaries / "murmur"
    assert "Start with:  murmur explore" in run(murmur, "--help", cwd=elsewhere).stdout
    place = run(binaries / "python", "-c", "import murmur; print(murmur.__file__)", cwd=elsewhere).stdout
    assert Path(place.strip()).is_relative_to(tmp_path / "venv")
    demo = ("explore", "--map", "office", "--robots", "2", "--bus", "memory", "--out", "run")
    first = run(murmur, *demo, cwd=elsewhere)
    assert "compiling for this machine, once: " in first.stderr
    assert first.stdout.startswith("Explored in ")
    assert (elsewhere / "run" / "maps.png").exists()
    assert json.loads((elsewhere / "run" / "summary.json").read_text())["coverage"] == 1.0
    assert run(murmur, "replay", "run", cwd=elsewhere).stdout.startswith("Replay matches")
    checked = run(murmur, "doctor", cwd=elsewhere)
    assert checked.stdout.count("ok ") == 6, checked.stdout
    assert "not installed; --view needs it" in checked.stdout
    run(*pip, "--no-deps", "--force-reinstall", sdist, cwd=elsewhere)
    assert run(murmur, "--version", cwd=elsewhere).stdout == f"murmur {_version()}\n"


def _version() -> str:
    version: str = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    return version


def test_the_container_file_is_well_formed_and_copies_all_packages() -> None:
    """No container engine is needed: instructions, sources of copies, and the syntax of shell commands are checked."""
    lines = [line for line in CONTAINER.splitlines() if line and not line.startswith("#")]
    parts = [re.match(r"([A-Z]+) (.+)", line) for line in lines]
    assert all(parts), lines
    steps = [(part[1], part[2]) for part in parts if part]
    assert {name for name, _ in steps} <= INSTRUCTIONS
    assert steps[0][0] == "FROM"
    copied = [source for name, text in steps if name == "COPY" for source in text.split()[:-1]]
    assert [source for source in copied if not (ROOT / source).exists()] == []
    assert set(PACKAGES) <= set(copied)
    for name, text in steps:
        if name == "RUN":
            subprocess.run(["sh", "-n", "-c", text], check=True)
        elif name in ("ENTRYPOINT", "CMD"):
            assert all(isinstance(word, str) for word in json.loads(text))


def test_the_container_runs_the_demo() -> None:
    given = re.findall(r"^(?:ENTRYPOINT|CMD) (.*)$", CONTAINER, re.M)
    command = [word for text in given for word in json.loads(text)]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert f"\t$(BIN)/{shlex.join(command)}\n" in makefile


def test_the_packages_of_the_project_are_those_of_the_wheel() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    include = project["tool"]["setuptools"]["packages"]["find"]["include"]
    assert [name.removesuffix("*") for name in include] == list(PACKAGES)


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_make_keeps_bytecode_also_if_the_environment_forbids_it() -> None:
    rule = 'probe: ; @echo "[$$PYTHONDONTWRITEBYTECODE]"'
    command = ["make", "--silent", f"--eval={rule}", "probe"]
    env = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    env["PYTHONDONTWRITEBYTECODE"] = "1"
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
