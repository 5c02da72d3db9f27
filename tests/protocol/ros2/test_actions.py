"""The action navigate_to_pose between two nodes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from protocol.ros2.actions import ActionClient, ClientGoal, ServerGoal, Status
from protocol.ros2.interfaces import CANCEL_GOAL, NAVIGATE_TO_POSE
from protocol.ros2.messages import POSE_STAMPED
from protocol.ros2.node import Ros2Node
from tests.protocol.ros2.waiting import spin_until

OpenNode = Callable[..., Ros2Node]


@dataclass
class Navigation:
    """A robot with nav2, and a client that sends goals."""

    robot: Ros2Node
    murmur: Ros2Node
    client: ActionClient
    goals: list[ServerGoal] = field(default_factory=list)
    ended: list[ClientGoal] = field(default_factory=list)
    accepts: bool = True
    cancels: bool = True

    def send(self, x: float) -> ClientGoal:
        """Send the goal (x, 0)."""
        messages = self.murmur.messages
        pose = messages.new(POSE_STAMPED, header=messages.header("map", 3), pose=messages.pose(x, 0.0, 0.0))
        goal = messages[f"{NAVIGATE_TO_POSE}_Goal"](pose=pose, behavior_tree="")
        return self.client.send(goal, 3, self.ended.append)

    def until(self, condition: Callable[[], object]) -> None:
        """Let both nodes work until a condition holds."""
        spin_until(condition, self.murmur, self.robot)

    def of(self, part: str, **fields: Any) -> Any:
        """Return a message of the action."""
        return self.robot.messages.new(f"{NAVIGATE_TO_POSE}_{part}", **fields)


@pytest.fixture(params=["jazzy", "humble"])
def navigation(node: OpenNode, request: pytest.FixtureRequest) -> Iterator[Navigation]:
    robot = node("bt_navigator", "r1", distro=request.param)
    murmur = node("murmur", "r1", distro=request.param)
    made = Navigation(robot, murmur, murmur.action_client("navigate_to_pose", NAVIGATE_TO_POSE))

    def on_goal(goal: ServerGoal) -> bool:
        made.goals.append(goal)
        return made.accepts

    robot.action_server("navigate_to_pose", NAVIGATE_TO_POSE, on_goal, lambda _: made.cancels)
    spin_until(lambda: made.client.is_available)
    yield made


def test_a_goal_is_accepted_executed_and_succeeds(navigation: Navigation) -> None:
    sent = navigation.send(2.5)
    navigation.until(lambda: navigation.goals and navigation.goals[0].waiting)
    goal = navigation.goals[0]
    assert (goal.id, goal.message.pose.pose.position.x) == (sent.id, 2.5)
    assert sent.status is Status.ACCEPTED

    goal.execute(4)
    goal.feedback(navigation.of("Feedback", distance_remaining=1.5), 5)
    navigation.until(lambda: sent.feedback is not None and sent.status is Status.EXECUTING)
    assert sent.feedback.distance_remaining == 1.5

    goal.end(Status.SUCCEEDED, navigation.of("Result"), 6)
    navigation.until(lambda: navigation.ended)
    assert navigation.ended == [sent]
    assert sent.status is Status.SUCCEEDED


def test_a_goal_that_cannot_be_reached_is_aborted_with_its_result(navigation: Navigation) -> None:
    sent = navigation.send(9.0)
    navigation.until(lambda: navigation.goals)
    navigation.goals[0].end(Status.ABORTED, navigation.of("Result"), 6)  # before the client asks
    navigation.until(lambda: navigation.ended)
    assert sent.status is Status.ABORTED
    assert sent.result is not None


@pytest.mark.parametrize("status", [42, -1, Status.EXECUTING])
def test_a_goal_whose_result_has_no_final_status_ends_as_aborted(navigation: Navigation, status: int) -> None:
    sent = navigation.send(1.0)
    navigation.until(lambda: navigation.goals and navigation.goals[0].waiting)
    navigation.goals[0].waiting[0].reply(navigation.of("GetResult_Response", status=status), 5)
    navigation.until(lambda: navigation.ended)
    assert (sent.status, sent.result) == (Status.ABORTED, None)


def test_a_rejected_goal_ends_as_aborted(navigation: Navigation) -> None:
    navigation.accepts = False
    sent = navigation.send(1.0)
    navigation.until(lambda: navigation.ended)
    assert (sent.status, sent.result) == (Status.ABORTED, None)


def test_a_canceled_goal_ends_as_canceled(navigation: Navigation) -> None:
    sent = navigation.send(1.0)
    navigation.until(lambda: navigation.goals and navigation.goals[0].waiting)
    navigation.client.cancel(sent, 4)
    navigation.until(lambda: sent.status is Status.CANCELING)
    navigation.goals[0].end(Status.CANCELED, navigation.of("Result"), 6)
    navigation.until(lambda: navigation.ended)
    assert sent.status is Status.CANCELED


def test_a_server_may_refuse_to_cancel(navigation: Navigation) -> None:
    navigation.cancels = False
    sent = navigation.send(1.0)
    navigation.until(lambda: navigation.goals and navigation.goals[0].waiting)
    navigation.client.cancel(sent, 4)
    navigation.goals[0].feedback(navigation.of("Feedback"), 5)
    navigation.until(lambda: sent.feedback is not None)
    navigation.goals[0].end(Status.SUCCEEDED, navigation.of("Result"), 6)
    navigation.until(lambda: navigation.ended)
    assert sent.status is Status.SUCCEEDED


def test_a_goal_ends_as_aborted_when_its_server_dies(navigation: Navigation) -> None:
    sent = navigation.send(1.0)
    navigation.until(lambda: navigation.goals and navigation.goals[0].waiting)
    navigation.robot.close()
    spin_until(lambda: navigation.ended, navigation.murmur)
    assert (sent.status, sent.result) == (Status.ABORTED, None)


def test_a_goal_without_a_server_ends_as_aborted(node: OpenNode) -> None:
    murmur = node("murmur")
    client = murmur.action_client("navigate_to_pose", NAVIGATE_TO_POSE)
    ended: list[ClientGoal] = []
    client.send(murmur.messages.new(f"{NAVIGATE_TO_POSE}_Goal"), 0, ended.append)
    spin_until(lambda: ended, murmur)
    assert ended[0].status is Status.ABORTED


def ask(navigation: Navigation, service: str, type_name: str, **fields: Any) -> Any:
    """Send a request with these fields to a service of the action; return the response."""
    murmur = navigation.murmur
    client = murmur.client(f"navigate_to_pose/_action/{service}", type_name)
    spin_until(lambda: client.is_available)
    responses: list[Any] = []
    request = murmur.messages.new(f"{type_name}_Request", **fields)
    client.call(request, 7, lambda each, _: responses.append(each))
    navigation.until(lambda: responses)
    return responses[0]


def test_the_result_of_an_unknown_goal_has_status_unknown(navigation: Navigation) -> None:
    response = ask(navigation, "get_result", f"{NAVIGATE_TO_POSE}_GetResult")
    assert response.status == Status.UNKNOWN


def test_a_request_to_cancel_without_an_id_cancels_all_running_goals(navigation: Navigation) -> None:
    sent = [navigation.send(float(number)) for number in range(3)]
    navigation.until(lambda: len(navigation.goals) == 3 and all(each.waiting for each in navigation.goals))
    navigation.goals[0].end(Status.SUCCEEDED, navigation.of("Result"), 6)
    response = ask(navigation, "cancel_goal", CANCEL_GOAL)
    assert response.return_code == 0
    canceled = {bytes(bytearray(each.goal_id.uuid)) for each in response.goals_canceling}
    assert canceled == {goal.id for goal in sent[1:]}
    navigation.until(lambda: [goal.status for goal in sent[1:]] == [Status.CANCELING] * 2)


def test_a_request_to_cancel_with_id_and_time_cancels_this_goal_and_all_accepted_until_then(
    navigation: Navigation,
) -> None:
    sent = [navigation.send(float(number)) for number in range(3)]
    navigation.until(lambda: len(navigation.goals) == 3 and all(each.waiting for each in navigation.goals))
    for goal, accepted_ns in zip(navigation.goals, (100, 200, 300), strict=True):
        goal.accepted_ns = accepted_ns
    last, messages = navigation.goals[2], navigation.murmur.messages
    info = messages.new(
        "action_msgs/msg/GoalInfo",
        goal_id=messages["unique_identifier_msgs/msg/UUID"](uuid=np.frombuffer(last.id, np.uint8)),
        stamp=messages.time(100),
    )
    response = ask(navigation, "cancel_goal", CANCEL_GOAL, goal_info=info)
    assert response.return_code == 0
    navigation.until(lambda: {goal.status for goal in (sent[0], sent[2])} == {Status.CANCELING})
    assert sent[1].status is Status.ACCEPTED


def test_a_request_to_cancel_all_goals_succeeds_without_any(navigation: Navigation) -> None:
    assert ask(navigation, "cancel_goal", CANCEL_GOAL).return_code == 0


def test_a_refused_request_to_cancel_all_goals_is_rejected(navigation: Navigation) -> None:
    navigation.cancels = False
    navigation.send(1.0)
    navigation.until(lambda: navigation.goals and navigation.goals[0].waiting)
    assert ask(navigation, "cancel_goal", CANCEL_GOAL).return_code == 1


def test_goals_of_one_client_have_different_ids(navigation: Navigation) -> None:
    assert len({navigation.send(float(number)).id for number in range(5)}) == 5


def test_a_goal_ends_only_once(navigation: Navigation) -> None:
    navigation.send(1.0)
    navigation.until(lambda: navigation.goals)
    goal = navigation.goals[0]
    with pytest.raises(ValueError, match="a goal that is ACCEPTED cannot end as EXECUTING"):
        goal.end(Status.EXECUTING, navigation.of("Result"), 6)
    goal.end(Status.SUCCEEDED, navigation.of("Result"), 6)
    with pytest.raises(ValueError, match="a goal that is SUCCEEDED cannot end as ABORTED"):
        goal.end(Status.ABORTED, navigation.of("Result"), 7)
