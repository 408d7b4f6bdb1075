"""Errors, checked configuration files, tick rates, required packages, and the shared files of the package."""

__all__ = ["arrays", "config", "errors", "rates", "requirements", "share", "sources", "stamps"]
