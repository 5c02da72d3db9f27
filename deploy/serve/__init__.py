"""The simulator as ROS 2 robots: what `murmur serve-ros2` runs.

`robot` and `swarm` are a core without sockets and clocks; `ros_robot` translates it to messages, and `process` runs it.
"""
