"""Bags: recorded from the running nodes, written from arrays, read back, summarised and compared."""
