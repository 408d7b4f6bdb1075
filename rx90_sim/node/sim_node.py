"""`rx90_sim`: the simulation node's executable."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from rx90_common.exchange.entry import run_node


def main(args: Sequence[str] | None = None) -> int:
    """Run the simulation node; return its exit code."""
    return run_node("rx90_sim", "rx90_sim.node.simulation", args)


if __name__ == "__main__":
    sys.exit(main())
