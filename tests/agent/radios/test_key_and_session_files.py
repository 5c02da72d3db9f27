"""Key files and session files: permissions, restarts, and what is refused."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from agent.radios.replay_window import MAX_SESSION, frame_number
from agent.radios.sealing import KEY_BYTES
from agent.radios.session_file import SessionFile, SessionFileError
from agent.radios.team_key import KeyFileError, create_key, read_key

KEY, OTHER = bytes(range(KEY_BYTES)), bytes(KEY_BYTES)


def test_a_new_key_is_random_and_only_its_owner_may_read_it(tmp_path: Path) -> None:
    one, other = tmp_path / "one.key", tmp_path / "other.key"
    before = os.umask(0)
    try:
        create_key(one)
        create_key(other)
    finally:
        os.umask(before)
    assert one.stat().st_mode & 0o777 == 0o600
    assert len(read_key(one)) == KEY_BYTES
    assert read_key(one) == read_key(one) != read_key(other)


def test_an_existing_file_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "team.key"
    path.write_text("something else")
    with pytest.raises(KeyFileError, match="already exists"):
        create_key(path)
    assert path.read_text() == "something else"


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o644])
def test_a_key_that_others_may_use_is_refused_with_the_command_that_helps(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "team.key"
    create_key(path)
    path.chmod(mode)
    with pytest.raises(KeyFileError, match=f"mode {mode:o}.*chmod 600 {path}"):
        read_key(path)


@pytest.mark.parametrize("text", ["", "abc", "0" * 62, "0" * 66, "x" * 64, "ä" * 32])
def test_what_is_no_key_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "team.key"
    path.write_text(text, encoding="utf-8")
    path.chmod(0o600)
    with pytest.raises(KeyFileError, match="64 hexadecimal digits"):
        read_key(path)


def test_a_missing_key_a_directory_and_a_pipe_are_refused(tmp_path: Path) -> None:
    with pytest.raises(KeyFileError, match="copy the team's key file"):
        read_key(tmp_path / "missing.key")
    os.mkfifo(tmp_path / "pipe", 0o600)
    for path in (tmp_path, tmp_path / "pipe"):
        with pytest.raises(KeyFileError, match="not a regular file"):
            read_key(path)


def test_each_start_has_a_session_of_its_own_and_knows_what_was_accepted(tmp_path: Path) -> None:
    path = tmp_path / "state" / "r1.session"
    first = SessionFile(path, KEY, 1, 3)
    assert (first.session, first.highest) == (1, {0: 0, 2: 0})
    first.note(2, frame_number(4, 10))
    first.note(2, frame_number(4, 12))
    first.sync()
    first.close()
    second = SessionFile(path, KEY, 1, 3)
    assert (second.session, second.highest) == (2, {0: 0, 2: frame_number(4, 12)})
    second.close()


def test_numbers_survive_a_process_that_is_killed(tmp_path: Path) -> None:
    path = tmp_path / "r0.session"
    child = os.fork()
    if child == 0:
        SessionFile(path, KEY, 0, 2).note(1, frame_number(1, 5))
        os._exit(9)
    os.waitpid(child, 0)
    with_state = SessionFile(path, KEY, 0, 2)
    assert (with_state.session, with_state.highest) == (2, {1: frame_number(1, 5)})
    with_state.close()


def test_each_key_has_numbers_of_its_own_that_continue_when_the_robot_returns_to_it(tmp_path: Path) -> None:
    path = tmp_path / "r0.session"
    first = SessionFile(path, KEY, 0, 2)
    first.note(1, frame_number(3, 3))
    first.close()
    other = SessionFile(path, OTHER, 0, 4)
    assert (other.session, other.highest) == (1, {1: 0, 2: 0, 3: 0})
    other.close()
    again = SessionFile(path, KEY, 0, 2)
    assert (again.session, again.highest) == (2, {1: frame_number(3, 3)})
    again.close()


def test_a_second_process_cannot_use_the_same_session_file(tmp_path: Path) -> None:
    path = tmp_path / "r0.session"
    first = SessionFile(path, KEY, 0, 2)
    with pytest.raises(SessionFileError, match="in use"):
        SessionFile(path, KEY, 0, 2)
    first.close()
    SessionFile(path, KEY, 0, 2).close()


def created(folder: Path) -> Path:
    """The path of a session file that has been used once."""
    session = SessionFile(folder / "r0.session", KEY, 0, 2)
    session.close()
    return session.path


def test_a_file_of_a_team_of_another_size_is_refused_and_not_changed(tmp_path: Path) -> None:
    path = created(tmp_path)
    before = path.read_bytes()
    with pytest.raises(SessionFileError, match="create a new team key"):
        SessionFile(tmp_path / "r0.session", KEY, 0, 3)
    assert path.read_bytes() == before


def test_a_robot_that_has_used_up_its_sessions_needs_a_new_key(tmp_path: Path) -> None:
    path = created(tmp_path)
    data = bytearray(path.read_bytes())
    data[8:16] = frame_number(MAX_SESSION, 0).to_bytes(8, "big")
    path.write_bytes(data)
    with pytest.raises(SessionFileError, match="create a new team key"):
        SessionFile(tmp_path / "r0.session", KEY, 0, 2)


def test_a_damaged_session_file_is_refused_and_not_changed(tmp_path: Path) -> None:
    path = created(tmp_path)
    whole = path.read_bytes()
    changed = bytes([whole[0] ^ 1]) + whole[1:]
    for data in (whole[:3], whole[:20], changed, b"not a session file", whole[:16] + b"\xff" * 8):
        path.write_bytes(data)
        with pytest.raises(SessionFileError, match="damaged"):
            SessionFile(tmp_path / "r0.session", KEY, 0, 2)
        assert path.read_bytes() == data


def test_a_session_file_can_be_closed_twice(tmp_path: Path) -> None:
    session = SessionFile(tmp_path / "r0.session", KEY, 0, 2)
    session.close()
    session.close()
    SessionFile(tmp_path / "r0.session", KEY, 0, 2).close()


def test_a_path_with_a_zero_byte_is_no_key_file() -> None:
    with pytest.raises(KeyFileError, match=r"null (byte|character)"):
        read_key(Path("team\0.key"))


def test_a_directory_that_cannot_hold_the_session_file_is_named_with_the_setting_that_helps(
    tmp_path: Path,
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(SessionFileError, match=r"r0-\w+\.session: .*; set radio\.sessions to a directory"):
        SessionFile(tmp_path / "file" / "r0.session", KEY, 0, 2)
