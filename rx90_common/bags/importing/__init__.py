"""Logs of others as CSV or in columns, with a file that says what their columns hold, as bags of joint states."""

__all__ = ["exact", "importing", "mapping"]
