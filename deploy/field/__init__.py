"""A robot in the field as a process: its settings file, its ROS 2 node, its files, and its loop (docs/field.md).

robot_file    the settings of one robot, from TOML
robot_plan    the settings of its control logic, derived from them
running       the lock and the request to stop of a robot that runs on this host
goals         goals over `goal_pose` or `navigate_to_pose`
connection    the robot's body and node, and what the body receives
ros2_robot    the robot: node and body together
mission       the loop from the first readings to the end
listener      receives what the robot's nodes send, and sends nothing
doctor        checks of what the listener has received
"""
