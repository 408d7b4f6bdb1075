"""The executable `friction_bench`."""

from __future__ import annotations

from collections.abc import Sequence

from rx90_common.exchange.entry import run_node


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return its exit code."""
    return run_node("friction_bench", "friction_bench.node.bench_node", args)
