"""Errors, quoted text, checked configuration files, tick rates, required packages, and the shared files."""

__all__ = [
    "arrays",
    "config",
    "errors",
    "groups",
    "quoting",
    "rates",
    "requirements",
    "section",
    "shapes",
    "share",
    "sources",
    "stamps",
    "versions",
]
