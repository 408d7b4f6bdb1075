"""Shared by all HTML reports of the suite: the page, and plots that are described once and drawn in one style."""
