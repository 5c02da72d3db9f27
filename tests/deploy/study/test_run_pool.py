"""Outcomes a line each: what is known is given again and not run again."""

from __future__ import annotations

import multiprocessing
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from deploy.study.run_pool import collect, read


@dataclass(frozen=True)
class Number:
    key: int


@dataclass(frozen=True)
class Square:
    key: int
    value: int


def square(number: Number) -> Square:
    return Square(number.key, number.key**2)


def fails(number: Number) -> Square:
    raise AssertionError(f"{number} was run again")


def test_what_a_file_knows_is_not_run_again(tmp_path: Path) -> None:
    file = tmp_path / "outcomes.jsonl"
    first = [Number(1), Number(2)]
    assert sorted(each.value for each in collect(first, square, Square, 1, file)) == [1, 4]
    assert [each.value for each in collect(first, fails, Square, 1, file)] == [1, 4]
    more = [Number(3), *first]
    assert [each.value for each in collect(more, square, Square, 1, file)] == [1, 4, 9]
    assert len(read(file, Square)) == 3


def test_an_outcome_is_kept_before_the_next_one_is_asked_for(tmp_path: Path) -> None:
    file = tmp_path / "outcomes.jsonl"
    results = collect([Number(1), Number(2)], square, Square, 1, file)
    next(results)
    assert len(read(file, Square)) == 1
    results.close()


def test_without_a_file_all_is_run() -> None:
    assert [each.value for each in collect([Number(4)], square, Square, 1, None)] == [16]


def waits_unless_it_is_1(number: Number) -> Square:
    if number.key > 1:
        time.sleep(60)
    return square(number)


def fails_at_2(number: Number) -> Square:
    assert number.key != 2, "two"
    return waits_unless_it_is_1(number)


def test_who_takes_no_more_outcomes_ends_the_others_at_once(tmp_path: Path) -> None:
    file = tmp_path / "outcomes.jsonl"
    began = time.monotonic()
    results = collect([Number(n) for n in (1, 2, 3, 4)], waits_unless_it_is_1, Square, 2, file)
    assert next(results).value == 1
    results.close()
    assert_all_end(began)
    assert read(file, Square) == [Square(1, 1)]


def test_a_run_that_fails_ends_the_others_at_once_and_finished_ones_are_kept(tmp_path: Path) -> None:
    file = tmp_path / "outcomes.jsonl"
    began = time.monotonic()
    with pytest.raises(AssertionError, match="two"):
        list(collect([Number(n) for n in (1, 3, 2, 4, 5)], fails_at_2, Square, 2, file))
    assert_all_end(began)
    assert read(file, Square) == [Square(1, 1)]


def assert_all_end(began: float) -> None:
    while multiprocessing.active_children():
        assert time.monotonic() - began < 30
        time.sleep(0.05)


@pytest.mark.parametrize("line", ["[", "3", '{"key": 1}', '{"key": 1, "value": 1, "more": 1}'])
def test_a_file_of_something_else_is_refused_and_left_alone(tmp_path: Path, line: str) -> None:
    file = tmp_path / "notes.txt"
    text = '{"key": 1, "value": 1}\n' + line
    file.write_text(text)
    with pytest.raises(ValueError, match=r"out = .*notes\.txt: line 2 is no outcome"):
        next(collect([Number(1)], fails, Square, 1, file))
    assert file.read_text() == text


def test_a_file_that_cannot_be_written_is_refused_before_the_first_run(tmp_path: Path) -> None:
    for file in (tmp_path / "missing" / "a.jsonl", tmp_path):
        with pytest.raises(ValueError, match=r"out = .*; name a file that can be written"):
            next(collect([Number(1)], fails, Square, 1, file))
