"""A robot in the field as a process: its settings file, its ROS 2 node, its files, and its loop (docs/field.md).

Start with `robot_file.py`, the settings of one robot; then `ros2_robot.py`, its node and body; and `mission.py`, the
loop from the first readings to the end. `doctor.py` checks what a robot's nodes send.
"""
