"""Invariants of the radio: budget, order and ledger, with correct, byzantine and silent robots."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from netshaper.ledger import (
    ANSWER,
    BROADCAST,
    CAUSES,
    DATA,
    EVERYONE,
    OFFER,
    balance,
)
from protocol import packet_codec, packet_index
from protocol.budget import UNLIMITED
from protocol.messages import (
    ConnectionReport,
    Open,
    RobotFrames,
    RoundReport,
)
from protocol.packet_codec import encode
from protocol.packets import DECLINED, Block
from tests.netshaper.network import Network, Step
from tests.netshaper.scenes import gossip, play, scenes, seeds
from tests.netshaper.scripted_robots import ByzantineRobot, Mute, Robot

either = st.one_of(scenes(), gossip())


def unicast_data(step: Step) -> Any:
    return (step.rows["frame"] == DATA) & (step.rows["carried"] == 1)


@given(either)
def test_no_step_carries_more_than_its_budget(scene: Any) -> None:
    budget = scene[0].budget
    for step in play(scene):
        carried = step.bytes_where(step.rows["carried"] == 1)
        assert carried == step.carried
        assert budget.fits(carried)


@given(either)
def test_every_submitted_byte_is_logged_once_as_carried_or_cut(scene: Any) -> None:
    settings, robots, cells, deaths = scene
    # A last step without living robots logs the frames sent after the previous step closed.
    steps = play((settings, robots, [*cells, {}], [*deaths, {}]))
    sent: Counter[int] = Counter()
    logged: Counter[int] = Counter()
    for step in steps:
        for sender, payload in step.submitted:
            sent[sender] += len(payload)
        for row in step.rows:
            logged[int(row["sender"])] += int(row["bytes"])
        for whole, carried, cut, _ in balance(step.rows).values():
            assert whole == carried + cut
    assert +sent == +logged


@given(scenes())
def test_only_the_receiver_of_a_unicast_frame_receives_it(scene: Any) -> None:
    for step in play(scene):
        for _, carried, _, received in balance(step.rows).values():
            broadcast = (step.rows["receiver"] == EVERYONE) & (step.rows["carried"] == 1)
            assert received == carried - step.bytes_where(broadcast)
        logged: Counter[tuple[int, int]] = Counter()
        for row in step.rows[unicast_data(step)]:
            logged[int(row["sender"]), int(row["receiver"])] += int(row["bytes"])
        delivered: Counter[tuple[int, int]] = Counter()
        for frame in step.delivered:
            if frame.kind == "data":
                delivered[frame.sender, frame.receiver] += len(frame.payload)
        assert delivered == logged


@given(scenes())
def test_a_broadcast_counts_once_for_any_number_of_receivers(scene: Any) -> None:
    for step in play(scene, deadly=False):
        rows = step.rows[(step.rows["frame"] == BROADCAST) & (step.rows["carried"] == 1)]
        assert (rows["bytes"] == 3).all()
        assert (rows["packets"] == 1).all()
        assert len(set(rows["sender"].tolist())) == len(rows)
        received = Counter(frame.sender for frame in step.delivered if frame.kind == "broadcast")
        assert received == +Counter(dict(rows[["sender", "received_by"]].tolist()))


@given(scenes())
def test_the_first_packet_beyond_the_budget_closes_the_medium(scene: Any) -> None:
    budget = scene[0].budget
    for step in play(scene):
        admitted = step.rows[(step.rows["carried"] == 1) | (step.rows["cause"] == CAUSES.index("budget"))]
        cut = np.flatnonzero(admitted["carried"] == 0)
        if budget.unlimited:
            assert not len(cut)
        elif len(cut):
            assert not admitted["carried"][cut[0] :].any()


@given(
    scenes(st.lists(st.sampled_from((Robot, Robot, Mute)), min_size=1, max_size=6)) | gossip(honest=True),
    seeds,
    seeds,
)
def test_the_order_in_which_the_relay_reads_robots_changes_nothing(scene: Any, one: int, other: int) -> None:
    for first, second in zip(play(scene, one, False), play(scene, other, False), strict=True):
        assert first.rows.tolist() == second.rows.tolist()
        assert sorted(first.reports, key=_by_robot) == sorted(second.reports, key=_by_robot)


def _by_robot(report: tuple[int, RoundReport]) -> tuple[int, int]:
    return report[0], report[1].round


@given(scenes())
def test_a_receiver_gets_its_offers_in_their_order_on_the_air(scene: Any) -> None:
    for step in play(scene):
        for receiver, event in step.phases:
            numbers = [each.connection for each in event.deliveries]
            assert numbers == sorted(numbers)
            for each in event.deliveries:
                assert each.sender != receiver
                if event.phase == "offers":
                    assert packet_codec.decode(each.payload)[0].map == each.map_id  # type: ignore[union-attr]
        played = step.rows[(step.rows["connection"] >= 0)]["connection"].tolist()
        assert played == sorted(played)


@given(scenes())
def test_both_ends_of_a_connection_get_the_same_report(scene: Any) -> None:
    for step in play(scene):
        reported: dict[int, set[ConnectionReport]] = {}
        for _, report in step.reports:
            for each in report.connections:
                reported.setdefault(each.connection, set()).add(each)
        for number, versions in reported.items():
            rows = step.rows[(step.rows["connection"] == number) & (step.rows["carried"] == 1)]
            carried = [int(rows["bytes"][rows["frame"] == frame].sum()) for frame in (OFFER, ANSWER, DATA)]
            assert versions == {ConnectionReport(number, *carried)}


@given(scenes())
def test_frames_are_cut_between_packets(scene: Any) -> None:
    for step in play(scene):
        for frame in step.delivered:
            if frame.kind == "data":
                assert packet_index.split(frame.payload)


@given(scenes())
def test_a_robot_out_of_range_receives_nothing(scene: Any) -> None:
    settings, _, cells, _ = scene
    for where, step in zip(cells, play(scene), strict=True):
        for frame in step.delivered:
            (ax, ay), (bx, by) = where[frame.sender], where[frame.receiver]
            assert math.hypot(ax - bx, ay - by) <= settings.range_cells
        far = step.rows[step.rows["cause"] == CAUSES.index("range")]
        assert not far["carried"].any()
        assert not far["received_by"].any()


@given(scenes())
def test_living_robots_get_every_round_while_the_medium_is_open_and_the_end(
    scene: Any,
) -> None:
    settings, robots, cells, deaths = scene
    network = Network(settings, robots)
    for at, where in enumerate(cells):
        step = network.step(at + 1, where, deaths[at])
        assert set(step.closed) - network.dead == set(where) - network.dead
        for robot in step.closed:
            opened = [event.round for number, event in step.opened if number == robot]
            assert opened == list(range(len(opened)))
            closed = settings.budget.limit == step.carried or CAUSES.index("budget") in step.rows["cause"]
            assert len(opened) == (settings.rounds if settings.robots > 1 else 0) or closed


@given(
    scenes(st.lists(st.sampled_from((Robot, Robot, ByzantineRobot, ByzantineRobot)), min_size=2, max_size=6))
)
def test_byzantine_robots_do_not_harm_correct_robots(scene: Any) -> None:
    settings, robots, cells, _ = scene
    settings = replace(settings, budget=UNLIMITED)
    byzantine = {number for number, robot in robots.items() if isinstance(robot, ByzantineRobot)}
    silent = {n: Quiet(n, len(robots), 0) if n in byzantine else robot for n, robot in robots.items()}
    none: list[Any] = [{} for _ in cells]
    for first, second in zip(
        play((settings, robots, cells, none)), play((settings, silent, cells, none)), strict=True
    ):
        assert _among(first, byzantine) == _among(second, byzantine)


class Quiet(Robot):
    """A robot that takes part and sends no frames."""

    def opens(self, event: Open) -> list[RobotFrames]:
        return [RobotFrames(event.step, event.round, "offers")]

    def answer(self, _rng: np.random.Generator) -> bytes:
        return encode([Block(DECLINED)])


def _among(step: Step, without: set[int]) -> list[Any]:
    """The rows between the other robots, without connection numbers, which count all connections."""
    rows = step.rows[~np.isin(step.rows["sender"], [*without])]
    rows = rows[~np.isin(rows["receiver"], [*without])]
    return sorted((row[1], *row[3:]) for row in rows.tolist())
