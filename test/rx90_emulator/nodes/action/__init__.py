"""A package, so that its files share the nodes that conftest.py starts."""
