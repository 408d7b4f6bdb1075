"""Points as they come from outside: joints in any order, and every way to be refused."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from rx90_common.base.errors import ExchangeError, Rx90Error, TrajectoryError
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.points import check_trajectory_bytes

NAMES = tuple(f"joint_{i}" for i in range(1, 7))
ROW = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
REST = [0.0] * 6


def create(**changed: Any) -> TrajectoryPoints:
    """Return three good points with something changed."""
    given: dict[str, Any] = {
        "robot_joints": NAMES,
        "joint_names": NAMES,
        "times": [1.0, 2.0, 3.0],
        "position": [ROW, ROW, ROW],
        "velocity": [REST, REST, REST],
        "acceleration": [REST, REST, REST],
    }
    return TrajectoryPoints.create(**(given | changed))


def test_joints_may_come_in_any_order() -> None:
    """Whatever the order of the names, each joint gets its own values, in all three tables."""
    plain = create(position=[ROW, REST, ROW], velocity=[ROW, ROW, REST], acceleration=[ROW, REST, ROW])
    for order in itertools.islice(itertools.permutations(range(6)), 0, 720, 7):
        shuffled = create(
            joint_names=[NAMES[i] for i in order],
            position=[[row[i] for i in order] for row in (ROW, REST, ROW)],
            velocity=[[row[i] for i in order] for row in (ROW, ROW, REST)],
            acceleration=[[row[i] for i in order] for row in (ROW, REST, ROW)],
        )
        for table in ("times", "position", "velocity", "acceleration"):
            assert np.array_equal(getattr(shuffled, table), getattr(plain, table))


NAN_ROW = [0.1, 0.2, math.nan, 0.4, 0.5, 0.6]
REFUSALS: list[tuple[dict[str, Any], str]] = [
    ({"joint_names": (*NAMES[:5], "joint_9")}, "unknown joint 'joint_9'; accepted: joint_1, joint_2"),
    ({"joint_names": (*NAMES[:5], "joint_1")}, "joint 'joint_1' stands 2 times; accepted: once"),
    ({"joint_names": NAMES[:5]}, "joint 'joint_6' is missing; accepted: all of"),
    ({"joint_names": ()}, "joint 'joint_1' is missing"),
    ({"times": [], "position": [], "velocity": [], "acceleration": []}, "no points; accepted: at least one"),
    ({"times": [-0.5, 2.0, 3.0]}, "point 0: time_from_start -0.5 s; accepted: 0, or a nanosecond and more"),
    ({"times": [1.0, 1.0, 2.0]}, "point 1: time_from_start 1 s after 1 s; accepted: increasing"),
    (
        {"times": [1.0, 2.0, 2.0], "position": [ROW, REST, ROW]},
        "point 2: time_from_start 2 s after 2 s; accepted: incr",
    ),
    ({"times": [1.0, 0.5, 3.0]}, "point 1: time_from_start 0.5 s after 1 s"),
    ({"times": [1.0, math.nan, 3.0]}, "point 1: time_from_start nan s; accepted: a number"),
    ({"times": [math.nan, 2.0, 3.0]}, "point 0: time_from_start nan s; accepted: a number"),
    ({"times": [1.0, 2.0, math.inf]}, "point 2: time_from_start inf s; accepted: a number up to"),
    ({"times": [1.0, 2.0, 2147483647.0]}, "point 2: time_from_start 2.14748e+09 s; accepted: a number up to"),
    ({"position": [ROW, ROW[:5], ROW]}, "point 1: 5 positions; accepted: 6"),
    ({"position": [ROW, ROW, [*ROW, 0.0]]}, "point 2: 7 positions"),
    ({"position": [ROW, [], ROW]}, "point 1: 0 positions"),
    ({"position": [[], [], []]}, "point 0: no positions"),
    ({"velocity": [REST, [], REST]}, "point 1: accelerations without velocities; accepted: velocities too"),
    ({"velocity": [REST, ROW[:5], REST]}, "point 1: 5 velocities; accepted: 6, or none"),
    ({"acceleration": [REST, REST, REST[:1]]}, "point 2: 1 accelerations"),
    ({"velocity": [[], [], []]}, "accelerations without velocities"),
    ({"position": [ROW, ROW, NAN_ROW]}, "point 2: positions of joint_3 is nan; accepted: a finite number"),
    ({"velocity": [REST, NAN_ROW, REST]}, "point 1: velocities of joint_3 is nan"),
    ({"acceleration": [[math.inf, *REST[1:]], REST, REST]}, "point 0: accelerations of joint_1 is inf"),
    ({"velocity": [REST, REST, [0, 0, 0, 0, -0.1, 0]]}, "point 2: joint_5 ends at -0.1 rad/s; accepted: 0"),
]


@pytest.mark.parametrize(("changed", "words"), REFUSALS, ids=[words[:40] for _, words in REFUSALS])
def test_a_bad_trajectory_is_refused_by_point_joint_and_reason(changed: dict[str, Any], words: str) -> None:
    """Each fault gives one line that names the point, the joint and what is accepted."""
    with pytest.raises(TrajectoryError) as caught:
        create(**changed)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, Rx90Error)


@pytest.mark.parametrize("later", [0.0, 5e-17, 2e-9, 0.9e-3])
def test_a_last_point_that_says_the_one_before_again_takes_its_place(later: float) -> None:
    """A plan sampled each 0.1 s whose duration is 0.2 s and little more has its end twice, and is taken once."""
    again = {"times": [0.1, 0.2, 0.2 + later], "position": [ROW, REST, [1e-16] * 6]}
    got = create(**again, velocity=[REST, [1e-10] * 6, REST])
    assert got.times.tolist() == [0.1, 0.2 + later]
    assert got.position.tolist() == [ROW, [1e-16] * 6]
    for other in ({"position": [ROW, REST, [2e-4] * 6]}, {"velocity": [REST, [0.1] * 6, REST]}):
        if later < 1e-9:
            with pytest.raises(TrajectoryError, match=r"point 2: time_from_start 0\.2 s after 0\.2 s"):
                create(**(again | other))
        else:
            assert len(create(**(again | other)).times) == 3
    for apart in (0.999999999e-3, 1e-3):
        assert len(create(**(again | {"times": [0.1, 0.2, 0.2 + apart]})).times) == 3
    with pytest.raises(TrajectoryError, match=r"point 2: time_from_start 0\.1999 s after 0\.2 s"):
        create(**(again | {"times": [0.1, 0.2, 0.1999]}))


def test_rest_is_what_joint_trajectory_controller_takes_for_it() -> None:
    """Up to float's epsilon the velocity at the end is 0; the next number is refused, and allowed as what it is."""
    epsilon = 2.0**-23
    for value in (5e-17, -1e-15, epsilon, -epsilon):
        assert not create(velocity=[REST, REST, [value] * 6]).velocity[-1].any()
    beyond = [0.0, float(np.nextafter(epsilon, 1.0)), 0.0, 0.0, 0.0, 0.0]
    with pytest.raises(TrajectoryError, match=r"joint_2 ends at 1\.19209e-07 rad/s; accepted: 0 within 1\.19e-07"):
        create(velocity=[REST, REST, beyond])
    assert create(velocity=[REST, REST, beyond], moving_end=True).velocity[-1].tolist() == beyond


def test_broken_bytes_of_a_trajectory_are_named_by_their_field() -> None:
    """A whole message passes; cut off anywhere, or with a length beyond its end, it is refused with the field."""
    # What rclpy makes of one joint "a" and one point at 0.5 rad and 2 s, stamped 1 s.
    message_bytes = bytes.fromhex(
        "00010000 01000000 00000000 01000000 00000000 01000000 02000000 61000000 01000000"
        "01000000 00000000 000000000000e03f 00000000 00000000 00000000 02000000 00000000"
    )
    check_trajectory_bytes(message_bytes)
    for length in range(len(message_bytes)):
        with pytest.raises(ExchangeError, match="message is cut off"):
            check_trajectory_bytes(message_bytes[:length])
    at = message_bytes.index(b"a") + 4
    for wrong, field in ((at, "points"), (at + 4, r"points\[0\].positions")):
        broken = message_bytes[:wrong] + b"\xff\xff\xff\x7f" + message_bytes[wrong + 4 :]
        with pytest.raises(ExchangeError, match=f"cut off in {field}: 2147483647 elements announced"):
            check_trajectory_bytes(broken)
