"""A measured run against a simulated one: the closed loop without ROS along the measured path, and how both agree.

layout (what a bag holds) -> setpoints (of the measured path, or the recorded ones) -> compare (closed loop, filters,
alignment) -> comparison (figures and verdict) -> summary, report.
"""

__all__ = ["compare", "comparison", "job", "options", "summary"]
