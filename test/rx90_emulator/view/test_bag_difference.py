"""Two recordings of one arm along time, and a recording against its set-points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from rx90_common.bags.comparison import compare_bags
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.recorded import START, ParameterChange, time_shift
from rx90_common.bags.writing import write_joint_states
from rx90_common.base.errors import BagError
from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.identification.options import MeasuredLayout
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view.player import difference_text, recording_text
from rx90_emulator.view.recording import Recording, open_recording
from rx90_emulator.view.track import Track, difference, path_error_track, tip_path

JOINTS = tuple(f"joint_{k}" for k in range(1, 7))
STEP = 1_000_000


def tip(setup: Setup, q: np.ndarray) -> np.ndarray:
    """Return where Pinocchio has the tip, m."""
    model, data = setup.robot.model, setup.robot.model.createData()
    pin.framesForwardKinematics(model, data, q)
    return np.array(data.oMf[model.getFrameId(setup.robot.tcp_frame)].translation)


def motion(time: np.ndarray) -> np.ndarray:
    """Return smooth joint angles, (n, 6) rad, at times in s."""
    return np.stack([0.4 * np.sin((0.5 + 0.3 * k) * time + k) for k in range(6)], axis=1)


def track(stamps: np.ndarray, values: np.ndarray) -> Track:
    """Return a track of joint angles."""
    return Track.of(JointSeries("/joint_states", JOINTS, stamps.astype(np.int64), values))[0]


def opened(path: Path, setup: Setup) -> Recording:
    """Return what is shown of a bag."""
    return open_recording(path, setup.robot, RobotFiles(), MeasuredLayout())


def test_worst_differences_are_those_of_the_comparison(tmp_path: Path, shipped: Setup) -> None:
    """Per joint, value and time of the largest difference are those of `rx90_bag compare`; at the tip Pinocchio's."""
    random = np.random.default_rng(4)
    stamps = np.arange(300) * STEP
    values = [motion(stamps * 1e-9) + 1e-4 * random.normal(size=(300, 6)) for _ in range(2)]
    for name, value in zip("ab", values, strict=True):
        write_joint_states(tmp_path / name, [JointSeries("/joint_states", JOINTS, stamps, value)])
    first, second = (opened(tmp_path / name, shipped) for name in "ab")
    found = difference(first.arm, second.arm, shipped.robot.chain, (first.path, second.path))
    compared = compare_bags(tmp_path / "a", tmp_path / "b").topics[0].values
    for worst, value in zip(found.worst_joints, compared, strict=True):
        assert (abs(worst.value), worst.time_ns) == (value.maximum, value.at_ns)
    distances = [np.linalg.norm(tip(shipped, b) - tip(shipped, a)) for a, b in zip(*values, strict=True)]
    np.testing.assert_allclose(found.tip.values["position"][:, 0], distances, rtol=0, atol=1e-12)
    assert found.worst_tip.time_ns == stamps[int(np.argmax(distances))]
    assert found.exact == 1.0


def test_bags_of_other_times_are_aligned(tmp_path: Path, shipped: Setup) -> None:
    """A run that was recorded later is the same once both begin together, and its changes come at their times."""
    stamps = np.arange(50) * STEP
    for name, later in (("a", 0), ("b", 7 * 10**9)):
        series = [
            JointSeries(topic, JOINTS, stamps + later, motion(stamps * 1e-9))
            for topic in ("/joint_states", "/friction_states", "/rx90_controller/reference")
        ]
        write_joint_states(tmp_path / name, series)
    first, second = (opened(tmp_path / name, shipped) for name in "ab")
    second = replace(second, changes=(ParameterChange("/rx90_controller", "servo.kp", "[1, 2]", 7_020_000_000),))
    shift = time_shift(START, first, second)
    assert shift == -7 * 10**9
    second = second.moved(shift)
    assert second.friction is not None
    assert second.reference is not None
    assert {track.begin_ns for track in (second.arm, second.friction, second.reference)} == {0}
    found = difference(first.arm, second.arm, shipped.robot.chain, (first.path, second.path))
    assert (found.worst_tip.value, found.exact) == (0.0, 1.0)
    said = recording_text(second, "arm", 0)
    assert r"| 0.020 | /rx90\_controller servo.kp | \[1, 2\] |" in said
    assert "/joint\\_states: 50, 1000 Hz" in said
    assert "-7.000000000 s" in difference_text(found, ("a", "b"), 0, shift)


def test_other_rates_and_gaps(shipped: Setup) -> None:
    """A recording of another rate is compared where both are, between its samples too, and not in its gaps."""
    first = track(np.arange(1000) * STEP, motion(np.arange(1000) * 1e-3))
    stamps = np.concatenate([np.arange(100, 200), np.arange(220, 500)]) * 3_000_000 + 1
    second = track(stamps, motion(stamps * 1e-9) + 2e-3)
    found = difference(first, second, shipped.robot.chain, (Path("a"), Path("b")))
    joints = found.joints.values["position"]
    assert (found.joints.begin_ns, found.joints.end_ns) == (301 * STEP, 999 * STEP)
    inside = (found.joints.time_ns > stamps[99]) & (found.joints.time_ns < stamps[100])
    assert np.isnan(joints[inside]).all()
    np.testing.assert_allclose(joints[~inside], 2e-3, rtol=0, atol=2e-6)  # of lines between samples 3 ms apart
    assert found.exact == 0.0


@pytest.mark.parametrize("apart", [10_000, 999])
def test_disjoint_times_are_refused(shipped: Setup, apart: int) -> None:
    """Recordings without a time in common, or with one message alone in a gap, are refused with both spans."""
    stamps = np.arange(500)
    first = track(stamps * STEP, motion(stamps * 1e-3))
    later = np.concatenate([[0], np.arange(apart, apart + 100)]) if apart == 999 else stamps + apart
    second = track(later * STEP + 1, motion(later * 1e-3))
    with pytest.raises(BagError, match=r"a from 0\.000 to 0\.499 s and b from .* no time in common; accepted: --align"):
        difference(first, second, shipped.robot.chain, (Path("a"), Path("b")))


def test_path_error_is_the_distance_across_the_path(shipped: Setup, tmp_path: Path) -> None:
    """What a tip lags behind its set-points is no path error, moving or at rest; what is across it is Pinocchio's.

    Before the first motion nothing counts, nor later than 0.2 s after its end.
    """
    stamps = np.arange(600)
    time = stamps * 1e-3
    target = np.zeros((600, 6))
    target[:, 0] = 0.5 * np.clip(time, 0.05, 0.3)  # rest, an arc about the base, rest
    target[:, 1:] = [0.3, 1.2, 0.1, 0.4, 0.2]
    arm = target.copy()
    arm[:, 0] = np.minimum(arm[:, 0], 0.5 * np.clip(time - 0.002, 0.05, 0.298))  # 2 ms late, and never quite there
    for row in (20, 150, 350, 510):
        arm[row, 1] += 1e-3
    series = [
        JointSeries("/joint_states", JOINTS, stamps * STEP, arm),
        JointSeries("/rx90_controller/reference", JOINTS, stamps * STEP, target),
    ]
    write_joint_states(tmp_path / "bag", series)
    recording = opened(tmp_path / "bag", shipped)
    found = path_error_track(recording.arm, recording.reference, shipped.robot.chain)
    assert found is not None
    error = found.values["position"][:, 0]
    lag = np.linalg.norm(tip(shipped, arm[100]) - tip(shipped, target[100]))
    assert lag > 3e-4
    np.testing.assert_array_equal(np.isfinite(error), (stamps >= 50) & (stamps <= 500))
    assert np.nanmax(np.delete(error, [150, 350])) < lag**2  # of an arc with a radius of some 0.7 m
    for row in (150, 350):
        off = tip(shipped, arm[row]) - tip(shipped, target[row])
        tangent = np.cross([0.0, 0.0, 1.0], tip(shipped, target[row]))
        across = off - (off @ tangent) * tangent / (tangent @ tangent)
        assert error[row] == pytest.approx(np.linalg.norm(across), rel=5e-3)
    points, largest = tip_path(recording.arm, found, shipped.robot.chain, 40)
    assert np.nanmax(largest) == np.nanmax(error)
    np.testing.assert_allclose(points[0], tip(shipped, arm[0]), atol=1e-12)
    np.testing.assert_allclose(points[-1], tip(shipped, arm[-1]), atol=1e-12)
