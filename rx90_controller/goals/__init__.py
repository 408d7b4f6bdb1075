"""The contract of FollowJointTrajectory without ROS: requests checked, tolerances, and what becomes of a goal."""
