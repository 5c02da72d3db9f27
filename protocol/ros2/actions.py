"""Servers and clients of actions, as navigate_to_pose: long tasks with feedback, cancellation, and a result.

ROS builds an action from three services (``send_goal``, ``cancel_goal``, ``get_result``) and two topics
(``feedback``, ``status``), all below ``<name>/_action``. The client requests the result as soon as the server has
accepted the goal; the server replies when the goal has ended.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import Any

import numpy as np

from protocol.ros2.attachments import Attachment
from protocol.ros2.endpoints import Endpoint, Link
from protocol.ros2.interfaces import CANCEL_GOAL
from protocol.ros2.messages import Messages, nanoseconds
from protocol.ros2.qos import DEFAULT, LATCHED
from protocol.ros2.services import UNLIMITED_S, Request, ServiceClient, ServiceServer
from protocol.ros2.tokens import digest
from protocol.ros2.topics import Publisher, Subscription

KEPT_GOALS = 32
"""Ended goals whose results a server keeps."""
_UUID, _GOAL_INFO = "unique_identifier_msgs/msg/UUID", "action_msgs/msg/GoalInfo"
_STATUS, _STATUSES = "action_msgs/msg/GoalStatus", "action_msgs/msg/GoalStatusArray"
_ACCEPTED, _REJECTED, _UNKNOWN_GOAL, _GOAL_ENDED = 0, 1, 2, 3
"""Return codes of a request to cancel."""


class Status(IntEnum):
    """State of a goal."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def is_end(self) -> bool:
        """Whether the goal has ended."""
        return self >= Status.SUCCEEDED


class ServerGoal:
    """A goal that a server has received. `message` is its content, `id` its 16 bytes."""

    def __init__(self, server: ActionServer, goal_id: bytes, message: Any, accepted_ns: int) -> None:
        self.id = goal_id
        self.message = message
        self.accepted_ns = accepted_ns
        self.status = Status.ACCEPTED
        self.response: Any = None
        self.waiting: list[Request] = []
        self._server = server

    def feedback(self, message: Any, now_ns: int) -> None:
        """Publish feedback."""
        self._server.publish_feedback(self, message, now_ns)

    def execute(self, now_ns: int) -> None:
        """Publish that work on the goal has begun."""
        self._server.change(self, Status.EXECUTING, now_ns)

    def end(self, status: Status, result: Any, now_ns: int) -> None:
        """End the goal with its result; ValueError if `status` is no end, or the goal has ended already."""
        if not status.is_end or self.status.is_end:
            raise ValueError(f"a goal that is {self.status.name} cannot end as {status.name}")
        self._server.end(self, status, result, now_ns)


OnGoal = Callable[[ServerGoal], bool]
"""Receives a new goal; returns whether the server accepts it."""
OnCancel = Callable[[ServerGoal], bool]
"""Receives a goal that a client wants to cancel; returns whether the server will end it."""


class ActionServer:
    """A server of an action of type `type_name`, as ``nav2_msgs/action/NavigateToPose``."""

    def __init__(self, link: Link, name: str, type_name: str, on_goal: OnGoal, on_cancel: OnCancel) -> None:
        self._messages, self._type = link.messages, type_name
        self._on_goal, self._on_cancel = on_goal, on_cancel
        self._goals: dict[bytes, ServerGoal] = {}
        below = f"{name}/_action"
        self._feedback = Publisher(link, f"{below}/feedback", f"{type_name}_FeedbackMessage", DEFAULT)
        self._status = Publisher(link, f"{below}/status", _STATUSES, LATCHED)
        services = (
            ("cancel_goal", CANCEL_GOAL, self._cancel),
            ("get_result", f"{type_name}_GetResult", self._get_result),
            ("send_goal", f"{type_name}_SendGoal", self._send_goal),
        )
        self.endpoints: list[Endpoint] = [self._feedback, self._status]
        for each, of_type, on_request in services:
            self.endpoints.append(ServiceServer(link, f"{below}/{each}", of_type, on_request))

    def change(self, goal: ServerGoal, status: Status, now_ns: int) -> None:
        """Set the state of a goal, and publish the states of all."""
        goal.status = status
        statuses = [
            self._messages[_STATUS](goal_info=self._info(each), status=int(each.status))
            for each in self._goals.values()
        ]
        self._status.publish(self._messages[_STATUSES](status_list=statuses), now_ns)

    def publish_feedback(self, goal: ServerGoal, feedback: Any, now_ns: int) -> None:
        """Publish the feedback of a goal."""
        message = self._messages[f"{self._type}_FeedbackMessage"](
            goal_id=_uuid(self._messages, goal.id), feedback=feedback
        )
        self._feedback.publish(message, now_ns)

    def end(self, goal: ServerGoal, status: Status, result: Any, now_ns: int) -> None:
        """End a goal, and answer the clients that wait for its result."""
        goal.response = self._messages[f"{self._type}_GetResult_Response"](status=int(status), result=result)
        self.change(goal, status, now_ns)
        for request in goal.waiting:
            request.reply(goal.response, now_ns)
        goal.waiting.clear()
        ended = [each.id for each in self._goals.values() if each.status.is_end]
        for goal_id in ended[:-KEPT_GOALS]:
            del self._goals[goal_id]

    def _send_goal(self, request: Request, now_ns: int) -> None:
        goal = ServerGoal(self, _id(request.message.goal_id), request.message.goal, now_ns)
        is_new = goal.id not in self._goals
        accepted = is_new and self._on_goal(goal)
        if accepted:
            self._goals[goal.id] = goal
        response = self._messages[f"{self._type}_SendGoal_Response"](
            accepted=accepted, stamp=self._messages.time(now_ns)
        )
        request.reply(response, now_ns)
        if accepted:
            self.change(goal, Status.ACCEPTED, now_ns)

    def _get_result(self, request: Request, now_ns: int) -> None:
        goal = self._goals.get(_id(request.message.goal_id))
        if goal is not None and goal.response is None:
            goal.waiting.append(request)
            return
        unknown = f"{self._type}_GetResult_Response"
        request.reply(goal.response if goal is not None else self._messages.new(unknown), now_ns)

    def _cancel(self, request: Request, now_ns: int) -> None:
        """Cancel the goal with an id, and all goals accepted until a time; without id and time, all goals."""
        info = request.message.goal_info
        goal_id, until_ns = _id(info.goal_id), nanoseconds(info.stamp)
        cancels_all = not any(goal_id) and not until_ns
        chosen = [
            each
            for each in self._goals.values()
            if cancels_all or each.id == goal_id or (until_ns and each.accepted_ns <= until_ns)
        ]
        running = [each for each in chosen if not each.status.is_end]
        canceling = [each for each in running if self._on_cancel(each)]
        if running:
            code = _ACCEPTED if canceling else _REJECTED
        elif not any(goal_id):
            code = _ACCEPTED
        else:
            code = _GOAL_ENDED if chosen else _UNKNOWN_GOAL
        response = self._messages[f"{CANCEL_GOAL}_Response"](
            return_code=code, goals_canceling=[self._info(each) for each in canceling]
        )
        request.reply(response, now_ns)
        for each in canceling:
            if not each.status.is_end:
                self.change(each, Status.CANCELING, now_ns)

    def _info(self, goal: ServerGoal) -> Any:
        return _goal_info(self._messages, goal.id, goal.accepted_ns)


class ClientGoal:
    """A goal that a client has sent.

    `status` is `Status.UNKNOWN` until the server has accepted the goal, and `Status.ABORTED` if it does not, does not
    answer, or dies. `result` is its result when it has ended, None without one.
    """

    def __init__(self, goal_id: bytes) -> None:
        self.id = goal_id
        self.status = Status.UNKNOWN
        self.result: Any = None
        self.feedback: Any = None
        """The last feedback."""


OnEnd = Callable[[ClientGoal], None]


class ActionClient:
    """A client of an action of type `type_name`."""

    def __init__(self, link: Link, name: str, type_name: str) -> None:
        self._messages, self._type = link.messages, type_name
        self._sent = 0
        self._goals: dict[bytes, tuple[ClientGoal, OnEnd]] = {}
        below = f"{name}/_action"
        self._send = ServiceClient(link, f"{below}/send_goal", f"{type_name}_SendGoal")
        self._cancel = ServiceClient(link, f"{below}/cancel_goal", CANCEL_GOAL)
        self._get_result = ServiceClient(link, f"{below}/get_result", f"{type_name}_GetResult", UNLIMITED_S)
        feedback = Subscription(
            link, f"{below}/feedback", f"{type_name}_FeedbackMessage", DEFAULT, self._take_feedback
        )
        status = Subscription(link, f"{below}/status", _STATUSES, LATCHED, self._take_status)
        self.endpoints: list[Endpoint] = [self._send, self._cancel, self._get_result, feedback, status]

    @property
    def is_available(self) -> bool:
        """Whether a server is known."""
        return self._send.is_available and self._get_result.is_available

    def send(self, goal: Any, now_ns: int, on_end: OnEnd) -> ClientGoal:
        """Send a goal; `Ros2Node.spin` calls `on_end` once, when the goal has ended in any way."""
        self._sent += 1
        sent = ClientGoal(digest(self._send.gid + self._sent.to_bytes(8, "little")))
        self._goals[sent.id] = sent, on_end
        request = self._messages[f"{self._type}_SendGoal_Request"](
            goal_id=_uuid(self._messages, sent.id), goal=goal
        )

        def on_response(response: Any, later_ns: int) -> None:
            if response is None or not response.accepted:
                self._end(sent, Status.ABORTED, None)
                return
            sent.status = max(sent.status, Status.ACCEPTED)
            wanted = self._messages[f"{self._type}_GetResult_Request"](goal_id=_uuid(self._messages, sent.id))
            self._get_result.call(wanted, later_ns, lambda found, _: self._take_result(sent, found))

        self._send.call(request, now_ns, on_response)
        return sent

    def cancel(self, goal: ClientGoal, now_ns: int) -> None:
        """Ask the server to cancel a goal; if it does, the goal ends as `Status.CANCELED`."""
        request = self._messages[f"{CANCEL_GOAL}_Request"](goal_info=_goal_info(self._messages, goal.id, 0))
        self._cancel.call(request, now_ns, lambda *_: None)

    def _take_result(self, goal: ClientGoal, response: Any) -> None:
        if response is None or response.status not in (Status.SUCCEEDED, Status.CANCELED, Status.ABORTED):
            self._end(goal, Status.ABORTED, None)
        else:
            self._end(goal, Status(response.status), response.result)

    def _end(self, goal: ClientGoal, status: Status, result: Any) -> None:
        goal.status, goal.result = status, result
        _, on_end = self._goals.pop(goal.id)
        on_end(goal)

    def _take_feedback(self, message: Any, _: Attachment) -> None:
        if found := self._goals.get(_id(message.goal_id)):
            found[0].feedback = message.feedback

    def _take_status(self, message: Any, _: Attachment) -> None:
        for each in message.status_list:
            found = self._goals.get(_id(each.goal_info.goal_id))
            if found and each.status in (Status.EXECUTING, Status.CANCELING):
                found[0].status = Status(each.status)


def _id(uuid: Any) -> bytes:
    return bytes(bytearray(uuid.uuid))


def _uuid(messages: Messages, goal_id: bytes) -> Any:
    return messages[_UUID](uuid=np.frombuffer(goal_id, np.uint8))


def _goal_info(messages: Messages, goal_id: bytes, stamp_ns: int) -> Any:
    return messages[_GOAL_INFO](goal_id=_uuid(messages, goal_id), stamp=messages.time(stamp_ns))
