"""The page of a run as a user meets it: the run waits for a viewer and obeys the buttons, and the page stays."""

from __future__ import annotations

import http.client
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest

from tests.system.browser import Browser

pytest.importorskip("rerun", reason="Rerun is not installed: pip install 'murmur-robots[view]'")

RUN = ["explore", "--map", "em", "--robots", "2", "--bus", "memory", "--steps", "30", "--view-as", "web"]
PAUSE, FASTER = (129, 18), (339, 18)
"""Pixels of buttons."""


def wait_for(condition: Callable[[], Any], process: subprocess.Popen[bytes], log: Path) -> Any:
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        if found := condition():
            return found
        assert process.poll() is None, log.read_text()
        time.sleep(0.2)
    raise AssertionError(f"in vain: {log.read_text()}")


def click(browser: Browser, place: tuple[int, int], done: Callable[[], bool]) -> None:
    """Click until it has the wanted effect; a browser that draws in software takes a while."""
    deadline = time.monotonic() + 120
    while not done():
        assert time.monotonic() < deadline, "the button has no effect"
        browser.click(*place)
        time.sleep(2.0)


def state_of(address: str) -> dict[str, Any]:
    url = urlsplit(address)
    connection = http.client.HTTPConnection(url.netloc, timeout=20)
    connection.request("GET", "/state", headers={"X-Murmur-Token": parse_qs(url.query)["token"][0]})
    answer = connection.getresponse()
    assert answer.status == 200
    state: dict[str, Any] = json.loads(answer.read())
    return state


@pytest.mark.long
def test_a_run_waits_for_a_viewer_obeys_its_buttons_and_its_page_stays(tmp_path: Path) -> None:
    log = tmp_path / "log"
    more = ["--wait-for-viewer", "--keep-serving", "--pace", "1", "--out", str(tmp_path / "run")]
    with Browser(1280, 720) as browser, log.open("wb") as output:
        command = [sys.executable, "-m", "deploy.commands.main", *RUN, *more]
        process = subprocess.Popen(command, stdout=output, stderr=output)
        try:
            found = wait_for(lambda: re.search(r"Dashboard: (\S+)", log.read_text()), process, log)
            address = found[1]
            assert "The run starts when a viewer has opened the page." in log.read_text()
            time.sleep(1.0)
            assert (state_of(address)["step"], state_of(address)["paused"]) == (0, True)

            browser.open(f"{address}&persist=0&renderer=webgl&theme=dark")
            wait_for(lambda: state_of(address)["step"] > 2, process, log)
            for paused in (True, False):
                click(browser, PAUSE, lambda paused=paused: state_of(address)["paused"] == paused)
            click(browser, FASTER, lambda: state_of(address)["speed"] != 1.0)

            wait_for(lambda: "The page stays open; press Ctrl-C to end." in log.read_text(), process, log)
            assert state_of(address)["ended"]
            process.send_signal(signal.SIGINT)
            assert process.wait(20) in (0, 1)
        finally:
            process.kill()
            process.wait()
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["reason"] != "interrupted"


SIZES = [(1280, 720), (1366, 768), (1920, 1080)]

MISFITS = """
(() => {
  const bar = document.getElementById("bar"), limits = bar.getBoundingClientRect(), found = [];
  if (bar.hidden || limits.right > innerWidth) found.push("bar");
  for (const each of bar.querySelectorAll("button, input, select, output")) {
    const box = each.getBoundingClientRect(), name = each.id || each.textContent;
    if (box.left < limits.left || box.right > limits.right || box.top < limits.top || box.bottom > limits.bottom)
      found.push(name + " outside the bar");
    if (each.scrollWidth > each.clientWidth + 1 || each.scrollHeight > each.clientHeight + 3)
      found.push(name + " has text outside its box");
    for (const other of bar.querySelectorAll("button, input, select, output")) {
      const off = other.getBoundingClientRect();
      if (each !== other && box.width && off.width && box.left < off.right - 1 && off.left < box.right - 1
          && box.top < off.bottom - 1 && off.top < box.bottom - 1) found.push(name + " overlaps " + other.id);
    }
  }
  return found;
})()
"""
"""Which parts of the bar lie outside it, overlap, or have text that does not fit."""

WRONG_BANDWIDTH = """
document.getElementById("bandwidth").value = "fast";
document.querySelector("[data-command=bandwidth]").click();
"""

SHOWS_A_STEP = "/[0-9]/.test(document.querySelector('#step')?.textContent)"
SHOWS_AN_ERROR = "document.querySelector('#message.error')?.textContent"


@pytest.mark.long
def test_the_buttons_fit_the_page_in_both_themes_and_three_sizes(tmp_path: Path) -> None:
    log = tmp_path / "log"
    team = ["--map", "office", "--robots", "8", "--range", "30%", "--pace", "4", "--steps", "900"]
    command = [sys.executable, "-m", "deploy.commands.main", *RUN, *team, "--out", str(tmp_path / "run")]
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=output)
    try:
        address = wait_for(lambda: re.search(r"Dashboard: (\S+)", log.read_text()), process, log)[1]
        wait_for(lambda: state_of(address)["step"] > 20, process, log)
        for number, (theme, size) in enumerate(product(("dark", "light"), SIZES)):
            with Browser(*size) as browser:
                browser.open(f"{address}&persist=0&renderer=webgl&theme={theme}")
                wait_for(lambda browser=browser: browser.evaluate(SHOWS_A_STEP), process, log)
                if number == 0:
                    browser.evaluate("document.querySelector('#pause').click()")
                assert browser.evaluate("getComputedStyle(document.body).colorScheme") == theme
                assert browser.evaluate(MISFITS) == []
                browser.evaluate(WRONG_BANDWIDTH)
                wait_for(lambda browser=browser: browser.evaluate(SHOWS_AN_ERROR), process, log)
                assert browser.evaluate(MISFITS) == []
                if folder := os.environ.get("MURMUR_PICTURES"):
                    png = browser.settled_picture(120.0, least=100_000)
                    Path(folder, f"page-{theme}-{size[0]}.png").write_bytes(png)
    finally:
        process.kill()
        process.wait()


def test_without_a_terminal_the_page_ends_with_the_run(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "deploy.commands.main", *RUN, "--out", str(tmp_path / "run")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode in (0, 1), done.stderr
    assert "Dashboard: http://127.0.0.1:" in done.stderr
    assert "The page stays open" not in done.stderr


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--wait-for-viewer"], "wait-for-viewer: needs a page; use --view-as web"),
        (["--keep-serving"], "keep-serving: needs a page; use --view-as web"),
        (["--share"], "share: there is no page with view-as = 'file'; use --view-as web"),
    ],
)
def test_flags_of_the_page_need_a_page(flags: list[str], message: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "deploy.commands.main", *RUN, "--out", str(tmp_path / "run")]
    done = subprocess.run(
        [*command[:-4], "--view-as", "file", *flags], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr == f"murmur: {message}\n"
