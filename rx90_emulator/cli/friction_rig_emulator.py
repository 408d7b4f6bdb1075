"""Run an emulated friction rig, with the real firmware, behind a pseudo-terminal that any serial program can open."""

from __future__ import annotations

import argparse
from pathlib import Path

from rx90_common.base.share import SHIPPED_RIG, resolve_config
from rx90_common.process.interrupts import stop_request
from rx90_emulator.cli.options import SEED


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--rig", default=SHIPPED_RIG, help="rig file (%(default)s)")
    parser.add_argument("--link", type=Path, help="symbolic link to make to the pseudo-terminal")
    parser.add_argument("--loaded", action="store_true", help="couple the revolute joint")
    parser.add_argument("--seed", type=SEED, default=0, help="of all noise (%(default)s)")


def main(options: argparse.Namespace) -> None:
    """Run until Ctrl-C or SIGTERM.

    Raises:
        Rx90Error: if the rig cannot be emulated, or the link cannot be made.
    """
    stop = stop_request()
    from friction_bench.rig.emulated import EmulatedRig, PtyRig
    from friction_bench.rig.rig_file import load_rig

    rig = load_rig(resolve_config(options.rig))
    emulated = EmulatedRig(rig, options.seed)
    emulated.plant.load(options.loaded)
    pty_rig = PtyRig(emulated, options.link)
    print(f"emulated rig at {options.link or pty_rig.path}, {rig.baud} baud; Ctrl-C ends it", flush=True)
    stop.wait()
    pty_rig.close()
