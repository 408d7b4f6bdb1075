"""The command `friction_rig_emulator`: an emulated rig that any serial program can open."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

from friction_bench.rig.emulated import EmulatedRig
from friction_bench.rig.pty_rig import PtyRig
from friction_bench.rig.rig_file import load_rig
from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.share import resolve_config


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="friction_rig_emulator",
        description="Run an emulated friction rig, with the real firmware, behind a pseudo-terminal.",
    )
    parser.add_argument("--rig", default="rig/gm8224.yaml", help="rig file (default: %(default)s)")
    parser.add_argument("--link", type=Path, help="symbolic link to make to the pseudo-terminal")
    parser.add_argument("--loaded", action="store_true", help="couple the revolute joint")
    parser.add_argument("--seed", type=int, default=0, help="seed of all noise (default: %(default)s)")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run until interrupted; return the exit code."""
    options = _parser().parse_args(argv)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    try:
        if not 0 <= options.seed < 2**31:
            raise ConfigError(f"--seed is {options.seed}; accepted: 0 to {2**31 - 1}")
        rig = load_rig(resolve_config(options.rig))
        emulated = EmulatedRig(rig, options.seed)
        emulated.plant.load(options.loaded)
        pty_rig = PtyRig(emulated, options.link)
    except Rx90Error as error:
        print(f"friction_rig_emulator: {error}", file=sys.stderr)
        return 1
    print(f"emulated rig at {options.link or pty_rig.path}, {rig.baud} baud; Ctrl-C ends it", flush=True)
    stop.wait()
    pty_rig.close()
    return 0
