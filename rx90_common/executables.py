"""The command-line tools' entry points: nothing slow is imported before Ctrl-C is handled."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable

from rx90_common.announcement import announce_compilation
from rx90_common.interrupts import raise_where_heard
from rx90_common.output import with_checked_output


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


rx90_line = _executable("rx90_line", "rx90_controller.line_command")
rx90_run = _executable("rx90_run", "rx90_loop.run_command")
rx90_bag = _executable("rx90_bag", "rx90_bag.command")
rx90_demo = _executable("rx90_demo", "rx90_demo.command")
rx90_sweep = _executable("rx90_sweep", "rx90_sweep.command")
friction_ramp = _executable("friction_ramp", "friction_bench.ramp_command")
friction_rig_emulator = _executable("friction_rig_emulator", "friction_bench.emulator_command")
rx90_experiment = _executable("rx90_experiment", "rx90_identification.experiments.command")
rx90_identify = _executable("rx90_identify", "rx90_identification.command")
