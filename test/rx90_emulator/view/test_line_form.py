"""A line as it is typed: what it comes to, and what is said of one that cannot be travelled."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from rx90_common.base.errors import LineError
from rx90_controller.lines.task import load_task
from rx90_controller.trajectory import TrajectoryGenerator
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view.line_form import LinePreview, preview_line, typed_line

TYPED = {"start": "0.6 -0.1 0.2", "end": "0.6, 0.1, 0.2", "speed": "0.25", "acceleration": "2", "tool": "0 180 0"}


def preview(setup: Setup, *typed: str, here: np.ndarray | None = None) -> LinePreview:
    """Plan and check a typed line of the shipped robot."""
    limits = setup.controller.limits(setup.robot)
    return preview_line(setup.robot, limits, 1e-3, load_task().branch, typed, here)  # type: ignore[arg-type]


def test_a_line_is_shown_with_what_it_comes_to(shipped: Setup) -> None:
    """The approach leads the tip from where Pinocchio has it to the start; time and speeds are the motion's own."""
    here = np.array([0.4, 0.3, 1.2, 0.1, 0.5, 0.2])
    found, robot = preview(shipped, *TYPED.values(), here=here), shipped.robot
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, here)
    tip = data.oMf[robot.model.getFrameId(robot.tcp_frame)].translation
    np.testing.assert_allclose(found.approach[[0, -1]], [tip, [0.6, -0.1, 0.2]], atol=1e-9)
    assert "0.200 m in 0.93 s" in found.text()  # 0.2 m / 0.25 m/s and 0.25 m/s / 2 m/s^2
    # The set-points as the controller makes them, against the speed limits.
    generator = TrajectoryGenerator(shipped.controller.limits(robot), 1e-3, here)
    end = generator.accept(found.line.points, 0, None).end
    speeds = np.abs(generator.setpoints(0, end)[:, 1])[int(found.line.approach * 1e3) :]
    np.testing.assert_allclose(found.share, speeds.max(axis=0) / robot.max_velocity, atol=1e-3)
    assert end * 1e-3 == pytest.approx(found.line.duration, abs=2e-3)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"start": "0.6 -0.1"}, "start is '0.6 -0.1'; accepted: 3 numbers, m"),
        ({"speed": ""}, "speed is ''; accepted: a number, m/s"),
        ({"speed": "-1"}, "the line's speed is -1 m/s; accepted: a number > 0"),
        ({"acceleration": "nan"}, "acceleration is 'nan'; accepted: a number, m/s^2"),
        ({"start": "1e308 1e308 1e308"}, "start is '1e308 1e308 1e308'; accepted: 3 numbers up to 1e+06, m"),
        ({"acceleration": "1e308"}, "accepted: a number up to 1e+06, m/s^2"),
        ({"tool": "0 180 -1e300"}, "tool is '0 180 -1e300'; accepted: 3 numbers up to 1e+06, deg"),
        ({"tool": "down"}, "tool is 'down'; accepted: 3 numbers, deg"),
        ({"end": "2 0 0"}, "at 0.300 m from its start (21%): elbow singularity, margin 0.0232; accepted: >= 0.05"),
        ({"speed": "30", "acceleration": "900"}, "rad/s (a line speed of about"),
        ({"acceleration": "900"}, "the controller would refuse the line"),
    ],
)
def test_a_line_that_cannot_be_travelled_is_one_sentence(shipped: Setup, change: dict[str, str], said: str) -> None:
    """The refusal names the value, or the place on the line, and what is accepted."""
    with pytest.raises(LineError, match=re.escape(said)) as refused:
        preview(shipped, *(TYPED | change).values())
    assert "accepted" in str(refused.value)


def test_the_fields_begin_with_the_reference_task(shipped: Setup) -> None:
    """What stands in the form at first is the robot's own line."""
    task = load_task()
    found = preview(shipped, *typed_line(task))
    assert replace(found.plan.task, rest_before=task.rest_before, rest_after=task.rest_after) == task
    assert found.line.approach == 0.0
