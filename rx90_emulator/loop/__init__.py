"""The closed loop without ROS: the same plant step and control law, tick by tick, in one process."""
