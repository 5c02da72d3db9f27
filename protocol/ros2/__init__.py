"""ROS 2 over Zenoh, without ROS: a node that nodes with rmw_zenoh see as one of theirs (docs/ros2.md).

`names`, `qos`, `attachments`, and `tokens` are the texts and bytes on the wire. `messages` and `interfaces` encode
messages. `node` offers topics, services (`services`), and actions (`actions`); `graph` lists what other nodes offer.
The package needs the extra ``ros2``; nothing else in Murmur imports it unless a setting requests ROS.
"""

from protocol.packages import require

require("rosbags", "ros2", "ROS 2 needs")
