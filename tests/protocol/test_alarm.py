"""The sleep of a thread ends when it should, or earlier if another thread sets an earlier time."""

from __future__ import annotations

import math
import threading
import time

from protocol.alarm import Alarm

LONG_S = 60.0


def sleeper(alarm: Alarm, times: list[float]) -> threading.Thread:
    def sleep() -> None:
        alarm.sleep(time.monotonic() + LONG_S)
        times.append(time.monotonic())

    thread = threading.Thread(target=sleep, daemon=True)
    thread.start()
    return thread


def test_an_alarm_wakes_a_sleeping_thread_and_not_before_its_time() -> None:
    alarm, times = Alarm(), list[float]()
    thread = sleeper(alarm, times)
    at = time.monotonic() + 0.05
    alarm.set(at)
    thread.join(LONG_S / 2)
    assert times[0] >= at


def test_a_later_alarm_does_not_postpone_an_earlier_one() -> None:
    alarm, times = Alarm(), list[float]()
    alarm.set(time.monotonic() + 0.05)
    alarm.set(time.monotonic() + LONG_S)
    sleeper(alarm, times).join(LONG_S / 2)
    assert times


def test_an_alarm_rings_once() -> None:
    alarm = Alarm()
    alarm.set(time.monotonic())
    alarm.sleep(time.monotonic() + LONG_S)
    until = time.monotonic() + 0.05
    alarm.sleep(until)
    assert time.monotonic() >= until


def test_a_closed_alarm_ends_all_sleep() -> None:
    alarm, times = Alarm(), list[float]()
    thread = sleeper(alarm, times)
    alarm.close()
    thread.join(LONG_S / 2)
    assert times
    alarm.sleep(time.monotonic() + LONG_S)


def test_a_thread_may_sleep_until_an_alarm_without_a_time_of_its_own() -> None:
    alarm, times = Alarm(), list[float]()

    def sleep() -> None:
        alarm.sleep(math.inf)
        times.append(time.monotonic())

    thread = threading.Thread(target=sleep, daemon=True)
    thread.start()
    alarm.set(time.monotonic() + 0.05)
    thread.join(LONG_S / 2)
    assert times
