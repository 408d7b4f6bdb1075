"""The command-line tools' entry points: nothing slow is imported before Ctrl-C is handled."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable

from rx90_common.kernels.announcement import announce_compilation
from rx90_common.process.interrupts import raise_where_heard
from rx90_common.process.output import with_checked_output


def _executable(program: str, module: str) -> Callable[[], int]:
    def main() -> int:
        raise_where_heard()
        announce_compilation(program)
        try:
            return with_checked_output(program, lambda: int(importlib.import_module(module).main()))
        except KeyboardInterrupt:
            print(f"{program}: interrupted", file=sys.stderr)
            return 130

    return main


rx90_line = _executable("rx90_line", "rx90_emulator.cli.line")
rx90_run = _executable("rx90_run", "rx90_emulator.cli.run")
rx90_bag = _executable("rx90_bag", "rx90_emulator.cli.bag")
rx90_demo = _executable("rx90_demo", "rx90_emulator.cli.demo")
rx90_sweep = _executable("rx90_sweep", "rx90_emulator.cli.sweep")
friction_ramp = _executable("friction_ramp", "rx90_emulator.cli.friction_ramp")
friction_rig_emulator = _executable("friction_rig_emulator", "rx90_emulator.cli.friction_rig_emulator")
rx90_experiment = _executable("rx90_experiment", "rx90_emulator.cli.experiment")
rx90_identify = _executable("rx90_identify", "rx90_emulator.cli.identify")
