"""Types of services and actions: `rosbags` knows only messages, so this module derives them as ROS does.

A service consists of a request and a response. An action consists of goal, result, and feedback, of which ROS makes two
services and a feedback message. The hash of a service is that of a type with request, response, and event.
"""

from __future__ import annotations

from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg

Fields = list[tuple[str, Any]]
Definitions = dict[str, tuple[list[Any], Fields]]
"""Constants and fields of each type, as a type store of rosbags takes them."""

CANCEL_GOAL = "action_msgs/srv/CancelGoal"
NAVIGATE_TO_POSE = "nav2_msgs/action/NavigateToPose"

_CANCEL_GOAL_REQUEST = "action_msgs/GoalInfo goal_info"
_CANCEL_GOAL_RESPONSE = """\
int8 ERROR_NONE=0
int8 ERROR_REJECTED=1
int8 ERROR_UNKNOWN_GOAL_ID=2
int8 ERROR_GOAL_TERMINATED=3
int8 return_code
action_msgs/GoalInfo[] goals_canceling
"""

_GOAL = "geometry_msgs/PoseStamped pose\nstring behavior_tree"
_FEEDBACK = """\
geometry_msgs/PoseStamped current_pose
builtin_interfaces/Duration navigation_time
builtin_interfaces/Duration estimated_time_remaining
int16 number_of_recoveries
float32 distance_remaining
"""
_RESULTS = {
    "humble": "std_msgs/Empty result",
    "jazzy": "uint16 error_code",
    "kilted": "uint16 error_code\nstring error_msg",
    "lyrical": "uint16 error_code\nstring error_msg",
}
_MORE_FEEDBACK = {"lyrical": "float32 position_tracking_error\nfloat32 heading_tracking_error"}

EVENT_INFO = "service_msgs/msg/ServiceEventInfo"
_EVENT_INFO_FIELDS = """\
uint8 event_type
builtin_interfaces/Time stamp
uint8[16] client_gid
int64 sequence_number
"""
"""ROS calls the type of ``client_gid`` char, and hashes it as uint8."""


def named(ros_type: str) -> tuple[Nodetype, str]:
    """Return the description of a field of a named type."""
    return Nodetype.NAME, ros_type


_ID = ("goal_id", named("unique_identifier_msgs/msg/UUID"))


def fields_of(text: str) -> tuple[list[Any], Fields]:
    """Return constants and fields of a message definition."""
    ((constants, fields),) = get_types_from_msg(text, "murmur/msg/Definition").values()
    return constants, fields


def service(name: str, request: Fields, response: Fields) -> Definitions:
    """Return the types of a service: its request, response, and event, and the type whose hash is the service's."""
    parts = [f"{name}_Request", f"{name}_Response", f"{name}_Event"]
    event: Fields = [("info", named(EVENT_INFO))]
    event += [
        (field, (Nodetype.SEQUENCE, (named(part), 1)))
        for field, part in zip(("request", "response"), parts, strict=False)
    ]
    whole: Fields = [
        (f"{field}_message", named(part))
        for field, part in zip(("request", "response", "event"), parts, strict=True)
    ]
    return {parts[0]: ([], request), parts[1]: ([], response), parts[2]: ([], event), name: ([], whole)}


def action(name: str, goal: str, result: str, feedback: str) -> Definitions:
    """Return the types of an action, from the definitions of its three parts."""
    types: Definitions = {
        f"{name}_Goal": fields_of(goal),
        f"{name}_Result": fields_of(result),
        f"{name}_Feedback": fields_of(feedback),
        f"{name}_FeedbackMessage": ([], [_ID, ("feedback", named(f"{name}_Feedback"))]),
    }
    accepted: Fields = [
        ("accepted", (Nodetype.BASE, ("bool", 0))),
        ("stamp", named("builtin_interfaces/msg/Time")),
    ]
    finished: Fields = [("status", (Nodetype.BASE, ("int8", 0))), ("result", named(f"{name}_Result"))]
    types |= service(f"{name}_SendGoal", [_ID, ("goal", named(f"{name}_Goal"))], accepted)
    types |= service(f"{name}_GetResult", [_ID], finished)
    return types


def definitions(distro: str) -> Definitions:
    """Return the types that nodes of a distribution have, and that rosbags lacks or hashes differently."""
    request, response = fields_of(_CANCEL_GOAL_REQUEST), fields_of(_CANCEL_GOAL_RESPONSE)
    types = service(CANCEL_GOAL, request[1], response[1])
    types |= action(NAVIGATE_TO_POSE, _GOAL, _RESULTS[distro], f"{_FEEDBACK}{_MORE_FEEDBACK.get(distro, '')}")
    types[EVENT_INFO] = fields_of(_EVENT_INFO_FIELDS)
    return types
