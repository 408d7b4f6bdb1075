"""A terminal for what a command draws only there."""

import io


class Terminal(io.StringIO):
    """What is shown where a terminal is: progress bars are drawn there alone."""

    def isatty(self) -> bool:
        return True
