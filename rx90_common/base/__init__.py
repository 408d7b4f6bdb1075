"""Errors, quoted text, checked configuration files, tick rates, and the shared files of the package."""

__all__ = ["arrays", "config", "errors", "quoting", "rates", "share", "sources", "stamps"]
