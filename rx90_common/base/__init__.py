"""Errors, quoted text, checked configuration files, tick rates, required packages, and the shared files."""

__all__ = [
    "arrays",
    "config",
    "declared",
    "entries",
    "errors",
    "extremes",
    "groups",
    "quoting",
    "rates",
    "requirements",
    "section",
    "share",
    "sources",
    "stamps",
    "versions",
]
