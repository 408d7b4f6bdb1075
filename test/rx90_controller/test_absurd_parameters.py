"""Parameters of the law that no drive has: refused where they are given, and where they get through the arm stops."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from refusals import refusal_by
from servo_rig import Rig

from rx90_common.base.entries import Number, Numbers
from rx90_common.description.robot_files import RobotFiles
from rx90_controller.law.parameters import load_controller
from rx90_controller.node.parameters import LAW_ENTRIES
from rx90_emulator.loop.setup import Setup

NUMBERS = {name: entry for name, entry in LAW_ENTRIES.items() if isinstance(entry, Number)}


@pytest.mark.parametrize("name", NUMBERS)
def test_a_value_that_no_drive_has_is_refused(
    shipped_files: RobotFiles, edited_yaml: Callable[..., Path], name: str
) -> None:
    """Every number that may change while the loops run has a largest one: it is taken, twice as much is refused."""
    entry, place = NUMBERS[name], tuple(name.split("."))
    shape = (lambda value: [value] * 6) if isinstance(entry, Numbers) else (lambda value: value)
    load_controller(edited_yaml(shipped_files.controller, place, shape(entry.high)))
    for absurd in (1e308, 2.0 * entry.high):
        said = refusal_by(load_controller, edited_yaml(shipped_files.controller, place, shape(absurd)))
        where = f"{name}[0]" if isinstance(entry, Numbers) else name
        assert f"{where} is {absurd!r}; accepted: " in said
        assert f"{entry.high:g}]" in said


@pytest.mark.parametrize("off", [0.0, 1e-3, -0.04])
def test_the_largest_values_together_give_finite_torques(
    shipped: Setup, shipped_files: RobotFiles, edited_yaml: Callable[..., Path], off: float
) -> None:
    """Whatever the checks let pass, the law computes: all at their largest, on a motor beside its set-point."""
    path = shipped_files.controller
    for name, entry in NUMBERS.items():
        path = edited_yaml(path, tuple(name.split(".")), [entry.high] * 6 if isinstance(entry, Numbers) else entry.high)
    rig = Rig(dataclasses.replace(shipped, controller=load_controller(path)))
    rig.loop.hold(rig.states(0))
    rig.position = off * np.asarray(shipped.drives.gear)
    assert rig.run(0, 400) == [True] * 400
    assert np.isfinite(rig.loop.command).all()


@pytest.mark.parametrize(
    ("field", "said"),
    [
        ("kp", "servo.kp"), ("kv", "servo.kv"), ("ki", "servo.ki"), ("inertia", "servo.inertia"),
        ("viscous", "feed_forward.viscous_friction"), ("coulomb", "feed_forward.coulomb_torque"),
    ],
)  # fmt: skip
def test_a_torque_that_is_no_number_stops_the_arm(shipped: Setup, rig: Rig, field: str, said: str) -> None:
    """One line names joint and parameter, no torque that is not finite goes out, and enable after mending goes on.

    The value comes past the checks, as one would by Python.
    """
    huge = np.array(getattr(shipped.controller, field))
    huge[3] = np.inf if field in ("ki", "viscous", "coulomb") else 1e308
    object.__setattr__(absurd := dataclasses.replace(shipped.controller), field, huge)
    good = rig.cs7b.law.copy()
    rig.loop.hold(rig.states(0))
    assert rig.run(0, 8) == [True] * 8
    heard: list[int] = []
    with np.errstate(all="ignore"):
        rig.loop.change_law(absurd.record(shipped.robot, shipped.drives, shipped.rates), heard.append)
    torques = rig.run(8, 40)
    assert not any(torques[4:])
    lines = [line for line in rig.around.lines if "torque nan Nm" in line]
    assert len(lines) == 1
    assert lines[0].startswith(f"joint_4: torque nan Nm at 0.002 s, by {said}; accepted: finite torques; torque off")
    assert np.isfinite(rig.loop.command).all()
    rig.loop.enable(True)  # nothing is mended: it stops again, and says so again
    assert not any(rig.run(48, 4))
    rig.loop.change_law(good, heard.append)
    rig.loop.enable(True)
    assert rig.run(52, 40) == [True] * 40
    assert sum("torque nan Nm" in line for line in rig.around.lines) == 2
    assert np.isfinite(rig.loop.command).all()
    assert np.isfinite(rig.cs7b.saturated).all()
