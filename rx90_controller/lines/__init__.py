"""Straight Cartesian lines of the tool: task, profile, path, plan and approach."""
