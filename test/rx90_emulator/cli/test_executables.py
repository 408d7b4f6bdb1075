"""The command-line tools are there at once: what is slow to import waits until it is needed."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    "module",
    [
        "rx90_emulator.cli.friction_ramp",
        "rx90_emulator.cli.bag",
        "rx90_emulator.cli.line",
        "rx90_emulator.cli.demo",
        "rx90_emulator.cli.identify",
        "rx90_emulator.cli.experiment",
        "rx90_emulator.cli.run",
        "rx90_emulator.cli.sweep",
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
