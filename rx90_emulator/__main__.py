"""`python -m rx90_emulator EXECUTABLE ...`: every executable without its console script."""

import sys

from rx90_emulator.cli.frame import main

if __name__ == "__main__":
    sys.exit(main())
