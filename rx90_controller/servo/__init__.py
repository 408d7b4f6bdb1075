"""The controller in operation: its states, the events that they answer, and what they act on; needs no ROS."""
