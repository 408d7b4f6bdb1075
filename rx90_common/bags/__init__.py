"""Bags: recorded from the running nodes, written from arrays, read back, summarised and compared."""

__all__ = [
    "batch",
    "comparison",
    "decoding",
    "exporting",
    "importing",
    "joint_series",
    "log_series",
    "mapping",
    "ordering",
    "plotting",
    "reading",
    "recorded",
    "summary",
    "tables",
    "tolerance",
    "topics",
    "writing",
]
