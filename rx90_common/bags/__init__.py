"""Bags: recorded from the running nodes, written from arrays, read back, summarised and compared."""

__all__ = [
    "comparison",
    "comparison_report",
    "joint_series",
    "ordering",
    "reading",
    "summary",
    "table",
    "tolerance",
    "topics",
    "writing",
]
