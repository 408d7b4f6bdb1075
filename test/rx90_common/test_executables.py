"""The command-line tools are there at once: what is slow to import waits until it is needed."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    "module",
    [
        "friction_bench.ramp_command",
        "rx90_bag.command",
        "rx90_controller.line_command",
        "rx90_demo.command",
        "rx90_identification.command",
        "rx90_identification.experiments.command",
        "rx90_loop.run_command",
        "rx90_sweep.command",
    ],
)
def test_help_needs_neither_compiler_nor_middleware(module: str) -> None:
    """A tool prints its help without having imported numba, SciPy or rclpy, which take seconds."""
    program = (
        f"import sys\nfrom {module} import main\n"
        "try:\n    main(['--help'])\n"
        "finally:\n    print(sorted({'numba', 'scipy', 'rclpy'} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.startswith("usage: ")
    assert done.stdout.endswith("\n[]\n")
