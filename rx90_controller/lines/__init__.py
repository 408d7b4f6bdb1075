"""Straight Cartesian lines of the tool: task, profile, path, plan and approach."""

__all__ = ["approach", "plan", "task"]
