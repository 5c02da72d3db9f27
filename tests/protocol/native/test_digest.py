"""The digest of a kernel's code: constants of each kind that Python's compiler makes."""

from __future__ import annotations

from types import FunctionType

from protocol.native.digest import digest_of


def first_two(values: list[int]) -> list[int]:
    return values[0:2]


def with_constant(constant: object) -> FunctionType:
    """Return the function with one more constant in its code."""
    code = first_two.__code__
    return FunctionType(code.replace(co_consts=(*code.co_consts, constant)), {})


def test_slices_which_are_constants_since_python_3_14_count() -> None:
    digests = [
        digest_of(with_constant(each), "", {}) for each in (slice(0, 2), slice(0, 3), slice(0, 2, 1), (0, 2))
    ]
    assert all(digests)
    assert len(set(digests)) == 4


def test_other_objects_have_no_digest() -> None:
    assert digest_of(with_constant(slice(0, object())), "", {}) == ""
    assert digest_of(with_constant(object()), "", {}) == ""
