"""`python -m rx90_emulator VERB ...` is `rx90 VERB ...`, and `python -m rx90_emulator NODE ...` runs a node.

Child processes start it by its path, `python .../rx90_emulator/__main__.py ...`.
"""

import sys

if not __package__:
    # The first of the path is this file's folder, whose modules are no top-level ones; a checkout lacks its parent.
    folder = __file__.rpartition("/")[0]
    sys.path[:] = [entry for entry in sys.path if entry != folder]
    sys.path.append(folder.rpartition("/")[0])

from rx90_emulator.cli.frame import main

if __name__ == "__main__":
    code = main()
    # CPython remembers an interrupt of an exec, as dataclasses are made with, until the next one, and would end a
    # program that -m has started by SIGINT in place of its exit code.
    exec("")
    sys.exit(code)
