"""Errors, quoted text, checked configuration files, tick rates, required packages, and the shared files."""
