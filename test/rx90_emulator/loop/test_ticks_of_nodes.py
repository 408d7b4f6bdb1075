"""What the nodes do in a tick is compiled before, and looking up set-points ahead changes nothing of it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from own_model import by_model

from rx90_common.base.arrays import Array
from rx90_controller.law import cs7b
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.setup import Setup

NAMES = tuple(f"joint_{i}" for i in range(1, 7))
REST = np.zeros(6)

_WARM = """
import gc
import numpy as np
from numba.core.dispatcher import Dispatcher
from rx90_controller.law.parameters import MODEL_PARTS
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.parameters import with_parameters
from rx90_emulator.loop.setup import Setup

def compiled():
    found = set()
    for each in gc.get_objects():
        try:
            if isinstance(each, Dispatcher):
                found |= {(each.py_func.__qualname__, id(each), signature) for signature in each.overloads}
        except ReferenceError:  # a proxy of something gone
            pass
    return found

by_model = {f"controller.feed_forward.{name}": True for name in MODEL_PARTS}
setup = with_parameters(Setup.load(), by_model)
plant, controller = setup.plant(), setup.cs7b()
plant.warm_up()
controller.warm_up()
plant.reset(np.zeros(6))
before = compiled()
assert before
names, rest = controller.joint_names, np.zeros(6)
controller.reset(plant.motor_states()[0])
for velocity, acceleration in ((False, False), (True, False), (True, True)):
    here = controller.trajectory.setpoints(controller.position_tick)[0, 0]
    rows = [here + 1e-3, here + 2e-3]
    points = TrajectoryPoints.create(
        names, names, [0.1, 0.2], rows, [rest if velocity else []] * 2, [rest if acceleration else []] * 2
    )
    controller.trajectory.accept(points, controller.position_tick, None)
    for tick in range(1000):
        if tick in (200, 240):
            controller.trajectory.set_speed_scaling(tick / 240, controller.position_tick)
        if tick == 300:
            controller.trajectory.halt(controller.position_tick)
        position, velocities, _ = plant.motor_states()
        plant.step(controller.step(position, velocities))
        plant.joint_states(), plant.friction_states(), controller.reference(), controller.tracking_error()
        controller.details()
    controller.skip(3)
plant.step(None)
plant.reset(rest)
print(sorted(name for name, _, _ in compiled() - before))
"""


def test_everything_is_compiled_before_the_first_tick() -> None:
    """After the warm-up of plant and controller, motions at any speed, reset and brakes compile and load nothing."""
    run = subprocess.run([sys.executable, "-c", _WARM], capture_output=True, text=True, timeout=300, check=False)
    assert (run.stdout, run.stderr) == ("[]\n", "")


REQUESTS: dict[str, Callable[[cs7b.CS7B, Array, int], object]] = {
    "skip": lambda controller, _, count: controller.skip(count),
    "reset": lambda controller, motor, count: controller.reset(motor, count),
    "scale": lambda controller, _, count: controller.trajectory.set_speed_scaling(
        (count % 5) / 4.0, controller.position_tick
    ),
    "halt": lambda controller, _, __: controller.trajectory.halt(controller.position_tick),
}
"""What may come between two ticks, beside a trajectory, with the motors' positions and a number."""


@settings(max_examples=60)
@given(st.data())
def test_looking_ahead_changes_no_bit(shipped: Setup, data: st.DataObject) -> None:
    """Whatever comes between two ticks, commands and set-points are those of a controller that samples each tick."""
    setup = data.draw(st.sampled_from([shipped, by_model(shipped)]))
    several, single = setup.cs7b(), setup.cs7b()
    both = (several, single)
    home = np.array([0.1, 0.3, 1.1, -0.2, 0.7, 0.3])
    motor = home * shipped.drives.gear
    for each in both:
        each.reset(motor)
    for _ in range(data.draw(st.integers(1, 10))):
        what = data.draw(st.sampled_from(["run", "run", "accept", *REQUESTS]))
        count = data.draw(st.integers(1, 400))
        if what == "accept":
            start = several.position_tick + data.draw(st.integers(0, 60))
            to = several.trajectory.setpoints(several.position_tick)[0, 0] + 1e-4 * count
            points = TrajectoryPoints.create(NAMES, NAMES, [0.1 + 1e-3 * count], [to], [REST], [REST])
            for each in both:
                each.trajectory.accept(points, each.position_tick, start)
        elif what != "run":
            for each in both:
                REQUESTS[what](each, motor, count)
        else:
            ahead = ticks(several, motor, count)
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(cs7b, "_LOOKAHEAD", 1)
                np.testing.assert_array_equal(ahead, ticks(single, motor, count))


def ticks(controller: cs7b.CS7B, motor: Array, count: int) -> Array:
    """Run ticks with motors at rest; return torques, set-points, their velocities and feed-forward, (count, 4, 6)."""
    return np.array([np.array([controller.step(motor, REST), *controller.reference()]) for _ in range(count)])
