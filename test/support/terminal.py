"""A terminal for what a command draws only there."""

from __future__ import annotations

import io


class Terminal(io.StringIO):
    """What is shown where a terminal is: progress bars are drawn there alone."""

    def isatty(self) -> bool:
        """Return that it is one."""
        return True
