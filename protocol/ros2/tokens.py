"""Liveliness tokens: keys that show nodes and endpoints to ``ros2 node list`` and ``ros2 topic list``.

A node has ``@ros2_lv/<domain>/<session>/<node id>/<node id>/NN/<enclave>/<namespace>/<name>``. Its endpoints have the
same with their own id and kind, and ``/<name>/<type>/<hash>/<quality of service>`` added. Names are mangled: ``/`` is
``%``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

from protocol.errors import ProtocolError, shown
from protocol.packages import require
from protocol.ros2 import names
from protocol.ros2.qos import Qos, parse_qos

try:
    import xxhash
except ModuleNotFoundError:
    require("xxhash", "ros2", "ROS 2 needs")  # but bags do not

ROOT = "@ros2_lv"
NODE_PARTS, ENDPOINT_PARTS = 9, 13
MAX_ID = 2**31 - 1


class Kind(StrEnum):
    """What a token stands for."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVER = "SS"
    CLIENT = "SC"


@dataclass(frozen=True)
class NodeToken:
    """A node: its domain, the id of its Zenoh session (hexadecimal), its id there, its namespace and name."""

    domain: int
    session: str
    node_id: int
    namespace: str
    name: str
    enclave: str = "/"

    def __str__(self) -> str:
        return self.text(self.node_id, Kind.NODE)

    def text(self, entity_id: int, kind: Kind) -> str:
        """Return the token of the node, or the first parts of that of an endpoint."""
        where = f"{ROOT}/{self.domain}/{self.session}/{self.node_id}/{entity_id}/{kind}"
        return f"{where}/{names.mangled(self.enclave)}/{names.mangled(self.namespace)}/{self.name}"

    @property
    def full_name(self) -> str:
        """Namespace and name, as ``ros2 node list`` prints them."""
        return f"{self.namespace.rstrip('/')}/{self.name}"


@dataclass(frozen=True)
class EndpointToken:
    """An endpoint of a node: its id, its kind, the key of its topic or service, its quality of service."""

    node: NodeToken
    entity_id: int
    kind: Kind
    data_key: names.DataKey
    qos: Qos

    def __str__(self) -> str:
        key = self.data_key
        what = f"{names.mangled(key.name)}/{names.dds_type(key.type)}/{key.type_hash}/{self.qos}"
        return f"{self.node.text(self.entity_id, self.kind)}/{what}"


def digest(data: bytes) -> bytes:
    """Return the 16 bytes of XXH3-128, the high 64 bits first, big-endian."""
    return xxhash.xxh3_128(data).digest()


def gid(token: str) -> bytes:
    """Return the 16 bytes that identify an endpoint: the `digest` of its token, reversed."""
    return digest(token.encode())[::-1]


def parse_token(token: str) -> NodeToken | EndpointToken:
    """Parse a token; ProtocolError says which part is wrong. Parts after the last known one are ignored."""
    parts = token.split("/")
    if parts[0] != ROOT or len(parts) < NODE_PARTS:
        raise _malformed(token, f"not {ROOT} and at least {NODE_PARTS} parts")
    _, domain, session, node_id, entity_id, kind, enclave, namespace, name, *what = parts
    try:
        if not re.fullmatch("[0-9a-f]{1,32}", session):
            raise ValueError(f"{shown(session)} is not the id of a Zenoh session")
        number, own_id = names.domain_of(domain), _id(node_id)
        namespace = names.check_node(name, names.demangled(namespace))
        node = NodeToken(number, session, own_id, namespace, name, names.demangled(enclave))
        if Kind(kind) is Kind.NODE:
            return node
        if len(parts) < ENDPOINT_PARTS:
            raise ValueError(f"{len(parts)} parts instead of {ENDPOINT_PARTS} for an endpoint")
        topic = names.qualified(names.demangled(what[0]))
        key = names.DataKey(node.domain, topic, names.ros_type(what[1]), names.check_hash(what[2]))
        return EndpointToken(node, _id(entity_id), Kind(kind), key, parse_qos(what[3]))
    except ValueError as error:
        reason = error.reason if isinstance(error, ProtocolError) else str(error)
        raise _malformed(token, reason) from None


def _id(text: str) -> int:
    if not re.fullmatch("[0-9]{1,10}", text) or int(text) > MAX_ID:
        raise ValueError(f"{shown(text)} is not an id, a number up to {MAX_ID}")
    return int(text)


def _malformed(token: str, reason: str) -> ProtocolError:
    return ProtocolError("ROS 2 liveliness token", 0, f"{reason}, in {shown(token)}")
