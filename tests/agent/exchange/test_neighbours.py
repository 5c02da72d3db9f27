"""Who is in whose range."""

import numpy as np

from agent.exchange.neighbors import Neighbors


def test_all_are_near_all_until_they_say_otherwise() -> None:
    neighbors = Neighbors(0, 4)
    assert neighbors.news([1, 2, 3]) == []
    assert np.flatnonzero(neighbors.hearers(2)).tolist() == [1, 3]
    neighbors.says(2, 3, here=False)
    assert np.flatnonzero(neighbors.hearers(2)).tolist() == [1]
    assert neighbors.are_near(3, 2)
    assert not neighbors.are_near(2, 3)


def test_who_has_left_is_news_until_all_in_range_have_heard_so() -> None:
    neighbors = Neighbors(0, 4)
    assert neighbors.news([1, 2]) == [(3, False)]
    neighbors.told([1], 3, here=False)
    assert neighbors.news([1, 2]) == [(3, False)]
    neighbors.told([2], 3, here=False)
    assert neighbors.news([1, 2]) == []
    assert neighbors.news([1, 2, 3]) == [(3, True)]


def test_who_begins_anew_has_heard_and_said_nothing() -> None:
    neighbors = Neighbors(0, 3)
    neighbors.says(1, 2, here=False)
    neighbors.told([1], 2, here=False)
    neighbors.begins_anew(1)
    assert neighbors.are_near(1, 2)
    assert neighbors.news([1]) == [(2, False)]
