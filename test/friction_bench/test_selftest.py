"""The self-test of a rig: a good one passes, each fault is found by its line of the table."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from rig_bench import greeted

from friction_bench.experiment import selftest
from friction_bench.experiment.selftest import self_test
from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig
from friction_bench.rig.messages import Fault
from friction_bench.rig.rig_file import Rig, load_rig
from rx90_common.base.share import SHIPPED_RIG, SOURCE_RIG, config_path
from rx90_emulator.cli.frame import run


def failed(client: RigClient) -> dict[str, str]:
    """Return what was found in each check that fails; the rig is off afterwards, with no fault latched."""
    found = {check.name: check.found for check in self_test(client) if not check.good}
    assert not client.port.emulated.board.stage_on
    assert client.last.report.fault == Fault.NONE
    return found


@pytest.mark.parametrize("file", [SHIPPED_RIG, SOURCE_RIG])
def test_a_good_rig_passes_at_rest(file: str) -> None:
    """All checks hold, twice in a row and after a latched fault, and the shaft does not turn."""
    client = greeted(load_rig(config_path(file)))
    client.arm()
    client.port.emulated.advance(0.3)  # nobody pumps: the watchdog's fault is latched
    assert failed(client) == {}
    assert failed(client) == {}
    assert client.port.emulated.plant.angle == 0.0


def test_a_fault_of_the_board_is_found(client: RigClient, emulated: EmulatedRig) -> None:
    """An encoder's line that counts along and a current sense with an offset fail the checks that show them."""
    advance, reading = emulated.plant.advance, emulated.plant.current_reading
    emulated.plant.advance = lambda *step: advance(*step) + 1
    emulated.plant.current_reading = lambda: reading() + 0.01
    assert failed(client).keys() == {"encoder counts of a shaft at rest", "ADC code, disarmed"}


def test_a_line_that_loses_reports_is_found(client: RigClient, emulated: EmulatedRig) -> None:
    """One report in ten that is damaged on the line is counted."""
    read, number = emulated.board.read, 0

    def lossy() -> bytes:
        nonlocal number
        data = read()
        number += bool(data)
        return data.replace(b"\0", b"\1") if data and number % 100 == 0 else data

    emulated.board.read = lossy
    assert failed(client).keys() == {"lost reports", "damaged frames"}


WATCHDOG, STOP = "ticks to torque off, without a host", "stage and DAC code after STOP"
ARM = "    if (state != DISARMED)\n        return RESULT_STATE;\n    travel_start"
MUTANTS = {
    "no watchdog": ("trip(FAULT_WATCHDOG);", ";", WATCHDOG, "more than 21"),
    "slow watchdog": (">= WATCHDOG_TICKS", ">= WATCHDOG_TICKS + 5u", WATCHDOG, "12"),
    "high torque": ("if (code > TORQUE_LIMIT_CODE)", "if (0)", "torque", "TORQUE code 230 was obeyed"),
    "high ramp": ("end > TORQUE_LIMIT_CODE", "0", "torque", "RAMP code 230 was obeyed"),
    "torque left on": ("    hal_stage(0);\n    drive(0);", "    hal_stage(0);", STOP, "off, 1"),
    "no arming": (ARM, "    return RESULT_STATE;\n    travel_start", "torque", "ARM: not possible"),
}
"""By text of core/rig.c, what stands in its place, the check that fails, and what is found."""


@pytest.mark.parametrize("name", MUTANTS)
def test_a_fault_of_the_firmware_is_found(name: str, make_mutant: Callable[..., Any], rig: Rig) -> None:
    """A firmware without one of its rules fails the check that shows it."""
    old, new, check, found = MUTANTS[name]
    client = greeted(rig, board=make_mutant("native", "core/rig.c", old, new))
    faults = {each.name: each.found for each in self_test(client) if not each.good}
    assert found in faults[check]


def test_other_figures_than_the_rig_file_s_end_the_test(client: RigClient, rig: Rig) -> None:
    """A firmware for another encoder fails the first check with both numbers; nothing is switched on after that."""
    client.rig = rig.replaced(counts_per_revolution=500)
    client.port.emulated.board.switched_on()
    (check,) = self_test(client)
    assert not check.good
    assert "counts_per_revolution is 500, the rig's firmware has 504" in check.found
    assert not client.port.emulated.board.switched_on()


def test_the_command_prints_a_table_and_tells_by_its_exit_code(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """0 and a line for each check on a good rig, 1 on one that fails, 3 where no rig answers."""
    assert run("rx90 rig", ["selftest"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 14
    assert all(line.endswith(": ok") for line in lines[1:])
    monkeypatch.setattr(selftest, "HIGHEST_IDLE_ADC", -1.0)
    assert run("rx90 rig", ["selftest"]) == 1
    assert sum(line.endswith(": WRONG") for line in capsys.readouterr().out.splitlines()) == 1
    assert run("rx90 rig selftest", ["--port", "/dev/nothing"]) == 3
    assert "/dev/nothing: cannot be opened" in capsys.readouterr().err
