"""Straight Cartesian lines of the tool: task and profile, joint path, plan and approach."""
