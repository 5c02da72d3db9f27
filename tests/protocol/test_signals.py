"""Signals that are held back, and signals during imports."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from pathlib import Path

import pytest

from protocol.signals import handled, held, is_importing, send_again


def test_a_signal_that_is_held_back_takes_effect_at_the_end_of_the_context() -> None:
    done: list[str] = []
    with pytest.raises(KeyboardInterrupt), handled([signal.SIGINT], signal.default_int_handler):
        with held():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)
            done.append("whole")
        done.append("more")
    assert done == ["whole"]


def test_other_threads_hold_back_no_signals() -> None:
    done: list[str] = []

    def work() -> None:
        with held():
            done.append("whole")

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == ["whole"]


def test_a_signal_during_an_import_is_sent_again_until_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = (
        "import os, signal, time",
        "os.kill(os.getpid(), signal.SIGUSR1)",
        "time.sleep(0.1)",
        "is_whole = True",
    )
    (tmp_path / "interrupted_module.py").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(tmp_path)
    seen: list[bool] = []

    def note(number: int, frame: object) -> None:
        seen.append(is_importing(frame))  # type: ignore[arg-type]
        if seen[-1]:
            send_again(number)

    with handled([signal.SIGUSR1], note):
        import interrupted_module  # type: ignore[import-not-found]

        while seen[-1]:
            time.sleep(0.01)
    assert interrupted_module.is_whole and seen[0] and not seen[-1]
    del sys.modules["interrupted_module"]
