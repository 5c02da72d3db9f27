"""The radio as it is, with robots that keep to the protocol, lie, say nothing, or die: its books balance."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from netshaper.ledger import CAUSES, EVERYONE, FIRST_ON_AIR, KIND_NUMBER
from netshaper.radio_options import RadioOptions
from tests.netshaper.network import Step
from tests.netshaper.scenes import gossip, play, scenes
from tests.netshaper.scripted_robots import Liar, Mute

troubles = st.builds(
    RadioOptions,
    loss=st.sampled_from((0.0, 0.3)),
    delay=st.integers(0, 2),
    jitter=st.integers(0, 2),
    duplication=st.sampled_from((0.0, 0.5)),
    bit_errors=st.sampled_from((0.0, 0.002)),
    checksums=st.just(True),
    frame_bytes=st.sampled_from((0, 70)),
    send_bytes=st.sampled_from((0, 40)),
    receive_bytes=st.sampled_from((0, 40)),
    reuse=st.booleans(),
    burst_every=st.sampled_from((0.0, 2.0)),
)


@st.composite
def troubled(draw: st.DrawFn) -> Any:
    chosen, *rest = draw(st.one_of(scenes(), gossip()))
    return replace(chosen, options=draw(troubles)), *rest


@settings(max_examples=60)
@given(troubled())
def test_every_byte_is_booked_and_no_limit_is_passed_whatever_robots_say(scene: Any) -> None:
    chosen, robots, _, deaths = scene
    in_turn = not any(deaths) and not any(isinstance(robot, Liar | Mute) for robot in robots.values())
    for step in play(scene):
        rows = step.rows
        carried, cause, sums = rows["carried"] == 1, rows["cause"], rows["kind"] == KIND_NUMBER["sum"]
        assert step.bytes_where(carried) == step.carried
        assert (carried == ((cause == 0) | (cause >= FIRST_ON_AIR))).all()
        unicast = carried & (rows["receiver"] != EVERYONE)
        assert (rows["received_by"][unicast] == (cause[unicast] == 0)).all()
        said, booked = sum(len(payload) for _, payload in step.submitted), step.bytes_where(~(carried & sums))
        assert booked == said or not in_turn, "what is said between steps is booked in the next one"
        for robot in range(chosen.robots):
            own = step.bytes_where(carried & (rows["sender"] == robot))
            assert chosen.budget.fits(own)
            assert not chosen.options.send_bytes or own <= chosen.options.send_bytes
        if not chosen.options.reuse:
            assert chosen.budget.fits(step.carried)


@settings(max_examples=15)
@given(troubled())
def test_the_order_in_which_robots_speak_up_changes_nothing(scene: Any) -> None:
    def books(steps: list[Step]) -> list[Any]:
        return [sorted(step.rows.tolist()) for step in steps if not said_out_of_turn(step)]

    one, other = (play(scene, interleaving, deadly=False) for interleaving in (0, 1))
    assert books(one) == books(other)


def said_out_of_turn(step: Step) -> bool:
    return bool((step.rows["cause"] == CAUSES.index("protocol")).any())
