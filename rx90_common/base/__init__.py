"""Errors, checked configuration files, tick rates, and the shared files of the package."""

__all__ = ["arrays", "config", "errors", "rates", "share", "sources", "stamps"]
