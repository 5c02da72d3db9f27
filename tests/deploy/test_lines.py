"""Outcomes a line each: what is known is given again and not run again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from deploy.lines import collect, read


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
