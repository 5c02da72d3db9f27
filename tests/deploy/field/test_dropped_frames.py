"""Advice on dropped frames: once per reason, and not for single damaged frames."""

from __future__ import annotations

from deploy.field.dropped_frames import SEVERAL, SEVERAL_REPLAYED, DropAdvice, ErrorReporter


def test_each_reason_is_explained_once_after_several_frames() -> None:
    advice = DropAdvice(robot=1, robots=3)
    assert list(advice.new({"not authentic": SEVERAL - 1, "replayed": SEVERAL_REPLAYED - 1})) == []
    (text,) = advice.new({"not authentic": SEVERAL, "replayed": SEVERAL_REPLAYED - 1})
    assert "another key, or settings that differ" in text
    (text,) = advice.new({"not authentic": 50, "own number": SEVERAL})
    assert (
        "its own number, 1: give each robot of a team another `robot`, and each team a key of its own" in text
    )
    (text,) = advice.new({"not authentic": 60, "own number": 9, "unknown sender": SEVERAL})
    assert "the size of its team, 3" in text
    (text,) = advice.new({"not authentic": 60, "own number": 9, "replayed": SEVERAL_REPLAYED})
    assert "two other robots have the same `robot` and key" in text and "a session file was lost" in text
    assert list(advice.new({"not authentic": 99, "own number": 99, "unknown sender": 99})) == []


def test_a_teammate_that_has_lost_its_session_file_is_explained_after_more_frames() -> None:
    advice = DropAdvice(robot=0, robots=2)
    assert list(advice.new({"replayed": SEVERAL_REPLAYED - 1})) == []
    (text,) = advice.new({"replayed": SEVERAL_REPLAYED})
    assert "a session file was lost or restored, so create a new key" in text
    assert list(advice.new({"replayed": 99})) == []


def test_malformed_messages_of_authentic_frames_are_explained_once() -> None:
    lines: list[str] = []
    report = ErrorReporter(lines.append)
    report("malformed message from robot 1: update 0, expected 1")
    first, advice = lines
    assert first == "malformed message from robot 1: update 0, expected 1"
    assert "two robots have the same `robot`" in advice and "a new record.folder on each" in advice
    report("malformed message from robot 0: no such entry")
    assert lines[2:] == ["malformed message from robot 0: no such entry"]
