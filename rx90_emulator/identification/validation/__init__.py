"""What bags that were not used say of an arm's friction: torques along them, and the closed loop along their path.

prediction: the torques of a friction along a recorded motion, with a verdict. measured: the closed loop without ROS
along the measured path or the recorded set-points, with a verdict on torques and positions.
"""
