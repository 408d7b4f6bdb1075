"""`python -m rx90_emulator EXECUTABLE ...`: every executable without its console script."""

import sys

from rx90_emulator.cli.frame import main

if __name__ == "__main__":
    code = main()
    # CPython remembers an interrupt of an exec, as dataclasses are made with, until the next one, and would end a
    # program that -m has started by SIGINT in place of its exit code.
    exec("")
    sys.exit(code)
