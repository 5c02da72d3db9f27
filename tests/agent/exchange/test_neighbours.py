"""Who is in whose range."""

import numpy as np

from agent.exchange.neighbours import Neighbours


def test_all_are_near_all_until_they_say_otherwise() -> None:
    neighbours = Neighbours(0, 4)
    assert neighbours.news([1, 2, 3]) == []
    assert np.flatnonzero(neighbours.hearers(2)).tolist() == [1, 3]
    neighbours.says(2, 3, here=False)
    assert np.flatnonzero(neighbours.hearers(2)).tolist() == [1]
    assert neighbours.are_near(3, 2)
    assert not neighbours.are_near(2, 3)


def test_who_has_left_is_news_until_all_in_range_have_heard_so() -> None:
    neighbours = Neighbours(0, 4)
    assert neighbours.news([1, 2]) == [(3, False)]
    neighbours.told([1], 3, here=False)
    assert neighbours.news([1, 2]) == [(3, False)]
    neighbours.told([2], 3, here=False)
    assert neighbours.news([1, 2]) == []
    assert neighbours.news([1, 2, 3]) == [(3, True)]


def test_who_begins_anew_has_heard_and_said_nothing() -> None:
    neighbours = Neighbours(0, 3)
    neighbours.says(1, 2, here=False)
    neighbours.told([1], 2, here=False)
    neighbours.begins_anew(1)
    assert neighbours.are_near(1, 2)
    assert neighbours.news([1]) == [(2, False)]
