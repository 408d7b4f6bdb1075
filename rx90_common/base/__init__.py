"""Errors, quoted text, checked configuration files, tick rates, required packages, and the shared files."""

__all__ = ["arrays", "config", "errors", "quoting", "rates", "requirements", "share", "sources", "stamps", "versions"]
