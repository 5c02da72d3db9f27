"""Names of topics, services, and types, and the Zenoh keys that they make.

A key is ``<domain>/<name>/<type>/<hash>``, for topics and services alike. The name keeps its inner slashes; the type is
the one of DDS, as ``sensor_msgs::msg::dds_::LaserScan_``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from protocol.errors import shown

MAX_DOMAIN = 232
"""Largest domain that ROS 2 allows."""

KINDS = ("msg", "srv", "action")
NO_HASH = "TypeHashNotSupported"
"""In place of a type hash: ROS 2 Humble has none."""

_PART = r"[A-Za-z_][A-Za-z0-9_]*"
_NAME = re.compile(rf"/{_PART}(/{_PART})*")
_TYPE = re.compile(rf"({_PART})/({'|'.join(KINDS)})/({_PART})")
_DDS_TYPE = re.compile(rf"({_PART})::({'|'.join(KINDS)})::dds_::({_PART})_")
_HASH = re.compile(rf"RIHS01_[0-9a-f]{{64}}|{NO_HASH}")


def qualified(name: str, namespace: str = "/", node: str = "") -> str:
    """Return a name with its namespace: ``scan`` in ``/r1`` is ``/r1/scan``; ``/scan`` stays; ``~`` is the node.

    Raises ValueError if the result is not a name of ROS.
    """
    root = namespace.strip("/")
    prefix = f"/{root}" if root else ""
    if name.startswith("/"):
        full = name
    elif name.startswith("~"):
        full = f"{prefix}/{node}/{name[1:].lstrip('/')}".rstrip("/")
    else:
        full = f"{prefix}/{name}"
    if not _NAME.fullmatch(full):
        raise ValueError(
            f"{shown(name)} in namespace {shown(namespace)} is not a name of ROS: parts between slashes have letters, "
            "digits, and underscores, and do not begin with a digit"
        )
    return full


def check_node(name: str, namespace: str) -> str:
    """Return the namespace of a node with one leading slash, ``/`` for none; ValueError for a wrong name."""
    if not re.fullmatch(_PART, name):
        raise ValueError(
            f"{shown(name)} is not the name of a node: letters, digits, and underscores, no digit first"
        )
    return qualified(name, namespace).rpartition("/")[0] or "/"


def dds_type(ros_type: str) -> str:
    """Return the DDS name of a type as ``std_msgs/msg/String``; ValueError if it is not a type of ROS 2."""
    match = _TYPE.fullmatch(ros_type)
    if match is None:
        raise ValueError(f"{shown(ros_type)} is not a type of ROS 2, as std_msgs/msg/String")
    return f"{match[1]}::{match[2]}::dds_::{match[3]}_"


def ros_type(dds: str) -> str:
    """Return the name of ROS of a DDS type; ValueError if it is none that ROS uses."""
    match = _DDS_TYPE.fullmatch(dds)
    if match is None:
        raise ValueError(f"{shown(dds)} is not a DDS type of ROS 2, as std_msgs::msg::dds_::String_")
    return f"{match[1]}/{match[2]}/{match[3]}"


def mangled(name: str) -> str:
    """Return a name as one part of a key: ``/`` becomes ``%``."""
    return name.replace("/", "%") or "%"


def demangled(part: str) -> str:
    """Return the name that `mangled` has encoded."""
    return part.replace("%", "/")


def check_hash(type_hash: str) -> str:
    """Return a type hash; ValueError if it is malformed."""
    if not _HASH.fullmatch(type_hash):
        raise ValueError(
            f"{shown(type_hash)} is not a type hash: RIHS01_ and 64 hexadecimal digits, or {NO_HASH}"
        )
    return type_hash


def check_domain(domain: int) -> int:
    """Return a domain (ROS_DOMAIN_ID); ValueError if it is out of range."""
    if not 0 <= domain <= MAX_DOMAIN:
        raise ValueError(f"domain {domain} is not from 0 to {MAX_DOMAIN}")
    return domain


def domain_of(part: str) -> int:
    """Return the domain that a part of a key has; ValueError if it is none."""
    if not re.fullmatch("0|[1-9][0-9]{0,2}", part):
        raise ValueError(f"{shown(part)} is not a domain, a number from 0 to {MAX_DOMAIN}")
    return check_domain(int(part))


@dataclass(frozen=True)
class DataKey:
    """The key of a topic or service: its domain, qualified name, type of ROS, and type hash."""

    domain: int
    name: str
    type: str
    type_hash: str

    def __str__(self) -> str:
        return f"{self.domain}/{self.name.strip('/')}/{dds_type(self.type)}/{self.type_hash}"
