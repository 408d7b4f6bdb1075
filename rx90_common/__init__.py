"""Shared by all packages: errors, checked configuration files, data folders, compilation, tick rates."""
