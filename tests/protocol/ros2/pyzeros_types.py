"""The message types that pyzeros uses, from ros2-pyterfaces and its own implementation of CDR and type hashes.

Annotations must be values here, not texts: the library resolves them.
"""

from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np
from ros2_pyterfaces.cyclone import all_msgs
from ros2_pyterfaces.cyclone.idl import IdlStruct, types

from protocol.ros2 import messages as names


@dataclass
class TFMessage(IdlStruct, typename=names.TRANSFORMS):
    """Transforms, which ros2-pyterfaces lacks."""

    transforms: types.sequence[all_msgs.TransformStamped] = field(default_factory=list)


ELEMENTS = {
    TFMessage: all_msgs.TransformStamped,
    all_msgs.MarkerArray: all_msgs.Marker,
    all_msgs.Marker: all_msgs.Point,
}
"""Type of the elements of the list of a message."""


def pyzeros_type(name: str) -> Any:
    """Return the class of a type."""
    return TFMessage if name == names.TRANSFORMS else getattr(all_msgs, name.rpartition("/")[2])


def to_pyzeros(kind: Any, message: Any) -> Any:
    """Return a message of ours as one of pyzeros."""
    made = kind()
    for each in fields(made):
        value, default = getattr(message, each.name), getattr(made, each.name)
        if is_dataclass(default):
            value = to_pyzeros(type(default), value)
        elif isinstance(value, list):
            value = [to_pyzeros(ELEMENTS[kind], element) for element in value]
        elif isinstance(value, np.ndarray) and not isinstance(default, np.ndarray):
            value = value.tolist()
        setattr(made, each.name, value)
    return made
