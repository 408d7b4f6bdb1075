"""Bags: recorded from the running nodes, written from arrays, read back, summarised and compared."""

__all__ = [
    "batch",
    "changes",
    "comparison",
    "joint_series",
    "ordering",
    "reading",
    "robot_name",
    "summary",
    "tables",
    "tolerance",
    "topics",
    "trajectories",
    "writing",
]
