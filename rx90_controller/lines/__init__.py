"""Straight Cartesian lines of the tool: task, profile, path and plan."""

__all__ = ["plan", "task"]
