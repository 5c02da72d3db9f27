"""ROS 2 over Zenoh, without ROS: a node that nodes with rmw_zenoh see as one of theirs (docs/ros2.md).

`names`, `qos`, `attachments`, and `tokens` are the texts and bytes on the wire. `messages` and `interfaces` encode
messages. `node` offers topics, services (`services`), and actions (`actions`); `graph` lists what other nodes offer.
The package needs the extra ``ros2``; nothing else in Murmur imports it unless a setting requests ROS.
"""

from importlib.util import find_spec

for _package in ("rosbags", "xxhash"):
    if find_spec(_package) is None:
        raise ModuleNotFoundError(
            f"ROS 2 needs the package {_package}: pip install 'murmur-robots[ros2]'", name=_package
        )
