"""Paths of the tool: against circles, SciPy's splines, integrals and minima, Pinocchio, and limits on dense samples."""

import math
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path as File

import numpy as np
import pinocchio as pin
import pytest
from grip_arm import JOINTS, POSTURE, write_urdf
from hypothesis import given, settings
from hypothesis import strategies as st
from pinocchio_chain import tip_pose
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from rx90_common.base.arrays import Array
from rx90_common.base.errors import LineError
from rx90_common.description.joint_model import robot_of_urdf
from rx90_common.description.robot import RobotModel
from rx90_controller.lines.plan import check_plan, describe_line, plan_line
from rx90_controller.lines.task import TrapezoidalProfile
from rx90_controller.paths.path import Path, Segment
from rx90_controller.paths.profile import LimitedProfile, SpeedLimit
from rx90_emulator.cli.frame import run
from rx90_emulator.loop.line import followed_accuracy, path_accuracy, plan_path, run_path
from rx90_emulator.loop.path_file import load_path, load_trajectory
from rx90_emulator.loop.setup import Setup

CENTER, RADIUS = np.array([0.6, 0.0, 0.2]), 0.05
POINTS = ((0.56, 0.01, 0.2), (0.54, 0.05, 0.21), (0.56, 0.1, 0.22), (0.6, 0.1, 0.2))


@pytest.fixture(scope="module")
def circle() -> Path:
    return load_path("paths/circle.yaml")


@pytest.fixture(scope="module")
def seam() -> Path:
    return load_path("paths/seam.yaml")


def test_arcs_lie_on_their_circles(circle: Path) -> None:
    """Place and derivatives of a full circle, and of an arc by three points, are those of sine and cosine."""
    angle = np.linspace(0.0, 1.999 * math.pi, 50)
    outward = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    onward = np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle], axis=1)
    arc = Path((0.65, 0.0, 0.2), (Segment(((0.6, 0.05, 0.2), (0.6, -0.05, 0.2)), "arc"),))
    for path, most in ((circle, 2.0 * math.pi), (arc, 1.5 * math.pi)):
        assert path.length == pytest.approx(RADIUS * most, rel=1e-12)
        rows = angle < most
        for order, wanted in enumerate((CENTER + RADIUS * outward, onward, -outward / RADIUS, -onward / RADIUS**2)):
            found = path.curve.at(RADIUS * angle[rows], order)
            np.testing.assert_allclose(found, wanted[rows], atol=1e-9 * np.abs(wanted).max())


def test_splines_are_scipys_by_their_length() -> None:
    """A spline's length is SciPy's integral, its places lie on SciPy's natural spline, its tangents have length 1."""
    start = (0.6, 0.0, 0.2)
    path = Path(start, (Segment(POINTS, "spline"),))
    points = np.array([start, *POINTS])
    over = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    spline = CubicSpline(over, points, bc_type="natural")
    ways = [quad(lambda u: np.linalg.norm(spline(u, 1)), a, b, epsabs=1e-13)[0] for a, b in pairwise(over)]
    assert path.length == pytest.approx(sum(ways), abs=1e-11)
    np.testing.assert_allclose(path.curve.at(np.append(0.0, np.cumsum(ways))), points, atol=1e-11)
    u = 0.4 * over[-1]
    there = sum(
        quad(lambda u: np.linalg.norm(spline(u, 1)), a, min(b, u), epsabs=1e-13)[0] for a, b in pairwise(over) if a < u
    )
    np.testing.assert_allclose(path.curve.at(np.array([there]))[0], spline(u), atol=1e-11)


def _derivative(values: Array, step: float) -> Array:
    return np.asarray((values[2:] - values[:-2]) / (2.0 * step))


@pytest.mark.parametrize("orientation", ["fixed", "tangent", "interpolated"])
def test_twists_are_the_derivatives_of_the_poses(seam: Path, orientation: str) -> None:
    """Along all pieces: differences of the places, and of the rotations by Pinocchio's logarithm, are the twists."""
    segments = seam.segments
    if orientation == "interpolated":
        turns = [(0.1, 3.0, 0.2), None, (0.0, 2.8, -0.5), (0.3, 3.1, 0.0)]
        segments = tuple(replace(one, end_rpy=rpy) for one, rpy in zip(segments, turns, strict=True))
    path = replace(seam, segments=segments, orientation=orientation)
    step = 1e-6
    edges = np.concatenate([path.curve.starts, path.curve.joints, path.curve.knots])
    for at in np.linspace(1e-3, path.length - 1e-3, 60):
        if np.abs(edges - at).min() < 3.0 * step:
            continue
        around = at + step * np.arange(-1, 2)
        poses, (first, second) = path.poses(around), path.twists(around)
        np.testing.assert_allclose(_derivative(poses.position, step)[0], first[1, :3], atol=1e-7)
        turn = pin.log3(poses.rotation[2] @ poses.rotation[0].T) / (2.0 * step)
        np.testing.assert_allclose(turn, first[1, 3:], atol=1e-6 * max(1.0, np.abs(first).max()))
        np.testing.assert_allclose(
            _derivative(first, step)[0], second[1], rtol=1e-4, atol=1e-4 * np.abs(second).max() + 1e-6
        )


def test_blends_join_place_tangent_and_curvature(seam: Path) -> None:
    """Nothing jumps up to the curvature, the tool never stops, and a blend stays within its zone of the corner."""
    for order, most in ((0, 1e-12), (1, 1e-9), (2, 1e-6)):
        assert seam.curve.jumps(order).max() < most
    assert len(seam.stops) == 2
    corner = np.array(seam.segments[0].points[-1])
    near = seam.curve.at(np.linspace(seam.curve.starts[1], seam.curve.starts[2], 101))
    assert np.linalg.norm(near - corner, axis=1).max() < seam.segments[0].zone * (1.0 + 1e-9)
    assert near[:, 0].max() <= corner[0] + 1e-9


@given(st.lists(st.floats(-0.02, 0.02), min_size=3, max_size=3), st.floats(0.01, 0.4))
@settings(max_examples=25, deadline=None)
def test_the_nearest_place_is_the_minimum_of_the_distance(seam: Path, off: list[float], at: float) -> None:
    """For any point near the seam: no place that SciPy's minimiser finds on a dense grid is closer."""
    point = seam.curve.at(np.array([at]))[0] + off
    found = seam.error(point[None])
    grid = np.linspace(0.0, seam.length, 4000)
    k = int(np.argmin(np.linalg.norm(seam.curve.at(grid) - point, axis=1)))
    best = minimize_scalar(
        lambda s: np.linalg.norm(seam.curve.at(np.array([s]))[0] - point),
        bounds=(grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]), method="bounded", options={"xatol": 1e-10},
    )  # fmt: skip
    if 1e-3 < float(found.along[0]) < seam.length - 1e-3:  # beyond its ends the path goes on along its tangents
        assert found.perpendicular[0] <= best.fun + 1e-9
        assert found.perpendicular[0] == pytest.approx(np.linalg.norm(seam.curve.at(found.along)[0] - point), abs=1e-9)


def test_a_path_that_crosses_itself_is_looked_for_where_the_tip_should_be(circle: Path) -> None:
    """At a circle's seam the distance along it follows the hint: 0 where it starts, its length where it ends."""
    tip = np.array([[0.65, 0.0, 0.2]] * 2)
    along = circle.error(tip, np.array([0.0, circle.length])).along
    np.testing.assert_allclose(along, [0.0, circle.length], atol=1e-9)


@given(
    speeds=st.lists(st.tuples(st.floats(0.02, 0.5), st.floats(0.02, 0.3)), min_size=1, max_size=5),
    acceleration=st.floats(0.3, 10.0), jerk=st.one_of(st.just(math.inf), st.floats(2.0, 100.0)), stop=st.booleans(),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_profiles_keep_limits(speeds: list[tuple[float, float]], acceleration: float, jerk: float, stop: bool) -> None:
    """On dense samples speed, acceleration and jerk stay within limits everywhere, and the motion covers the path."""
    ends = np.cumsum([0.0, *(way for _, way in speeds)]).tolist()
    limits = tuple(SpeedLimit(a, b, v) for (v, _), a, b in zip(speeds, ends[:-1], ends[1:], strict=True))
    stops = (0.0, *ends[1:2], ends[-1]) if stop and len(ends) > 2 else (0.0, ends[-1])
    profile = LimitedProfile(limits, stops, acceleration, jerk)
    times = np.linspace(0.0, profile.duration, 20_001)
    motion = profile.sample(times)
    assert motion.distance[[0, -1]].tolist() == [0.0, ends[-1]]
    for one in limits:
        inside = (motion.distance > one.begin + 1e-9) & (motion.distance < one.end - 1e-9)
        assert motion.speed[inside].max(initial=0.0) <= one.speed * (1.0 + 1e-6)
    assert motion.speed.min() >= -1e-9
    assert np.abs(motion.acceleration).max() <= acceleration * (1.0 + 1e-6)
    step = times[1]
    if math.isfinite(jerk):
        assert np.abs(np.diff(motion.acceleration)).max() / step <= jerk * (1.0 + 1e-3) + 1e-6 / step
    integrated = np.append(0.0, np.cumsum(0.5 * step * (motion.speed[1:] + motion.speed[:-1])))
    np.testing.assert_allclose(motion.distance, integrated, atol=2e-6 * ends[-1] + step**2 * acceleration)
    for at in stops[1:-1]:
        near = np.abs(motion.distance - at) < 1e-4
        assert motion.speed[near].min() < math.sqrt(2.0 * acceleration * 1e-4)


def test_one_segment_without_a_limited_jerk_is_the_trapezoid_of_a_line() -> None:
    own, line = LimitedProfile((SpeedLimit(0.0, 0.4, 0.1),), (0.0, 0.4), 1.0), TrapezoidalProfile(0.4, 0.1, 1.0)
    assert own.corners == pytest.approx(line.corners)
    times = np.linspace(-0.1, line.duration + 0.1, 997)
    for found, wanted in zip(own.sample(times), line.sample(times), strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_speed_is_lowered_where_joints_ask_for_it_and_said(shipped: Setup, seam: Path) -> None:
    """Far too fast a seam keeps all joint limits on every set-point; the remark names speed, joint and place."""
    fast = replace(seam, speed=2.0, acceleration=30.0, jerk=math.inf,
                   segments=tuple(replace(one, speed=None) for one in seam.segments))  # fmt: skip
    plan, limits = plan_path(shipped, fast), shipped.controller.limits(shipped.robot)
    setpoints = plan.setpoints(np.arange(0.0, plan.duration, 5e-4))
    assert (np.abs(setpoints[:, 1]) <= limits.velocity).all()
    assert (np.abs(setpoints[:, 2]) <= limits.acceleration).all()
    assert np.abs(setpoints[:, 2] / limits.acceleration).max() > 0.5, "not needlessly slow"
    check_plan(plan, limits, 1e-3, plan.start_pose)
    said = describe_line(plan)
    slowed = r"slowed to (\S+) m/s from 0\.\d+ to 0\.\d+ m: joint_6 reaches its acceleration limit"
    speeds = [float(speed) for speed in re.findall(slowed, said)]
    assert speeds
    with pytest.raises(LineError, match=r"at 0\.\d+ m joint_\d reaches its \w+ limit: (\S+) m/s there in place of 2;"):
        plan_path(shipped, replace(fast, speed_policy="hold"))
    assert plan_path(shipped, replace(fast, speed_policy="lower")).duration == plan.duration
    assert plan_path(shipped, seam).duration < 4.0 * plan.duration


@pytest.mark.parametrize(
    "segments",
    [
        (Segment(((0.6506, -0.05, 0.2),), zone=3e-4), Segment(((0.6006, 0.0, 0.2),))),
        (
            Segment(((0.60025, -0.05, 0.2),), zone=5e-5),
            Segment(((0.60025, -0.0498, 0.2),), zone=5e-5),
            Segment(((0.65, -0.0498, 0.2),)),
        ),
    ],
    ids=["a turn by 135 degrees within 0.6 mm", "a step aside by 0.2 mm"],
)
def test_a_bend_between_examined_places_is_slowed_down(shipped: Setup, segments: tuple[Segment, ...]) -> None:
    """With no curvature 1 mm beside it, and none between the directions there: set-points keep the limits."""
    plan = plan_path(shipped, Path((0.55, -0.05, 0.2), segments, 0.04, 1.0))
    setpoints = plan.setpoints(np.arange(0.0, plan.duration, 5e-4))
    assert (np.abs(setpoints[:, 2]) <= shipped.controller.limits(shipped.robot).acceleration).all()


def _tips(setup: Setup, q: Array) -> tuple[Array, Array]:
    poses = np.array([tip_pose(setup.robot, row) for row in q])
    return poses[:, :3, 3], poses[:, :3, :3]


def test_the_engine_follows_a_circle(shipped: Setup, circle: Path) -> None:
    """A circle of 50 mm at 100 mm/s: set-points on it, and the error of the run is that of a circle, by Pinocchio."""
    ran = run_path(shipped, circle)
    begin, end = ran.task.counted
    rows = (ran.times >= begin) & (ran.times <= end)
    tips, _ = _tips(shipped, ran.slow.reference[rows, 0])
    assert np.abs(np.linalg.norm((tips - CENTER)[:, :2], axis=1) - RADIUS).max() < 1e-7
    tips, turned = _tips(shipped, ran.slow.joint_states[rows, 0])
    flat = tips[:, :2] - CENTER[:2]
    error = np.hypot(np.linalg.norm(flat, axis=1) - RADIUS, tips[:, 2] - CENTER[2])
    accuracy = ran.path_accuracy
    middle = (accuracy.along > 1e-3) & (accuracy.along < circle.length - 1e-3)
    np.testing.assert_allclose(accuracy.perpendicular[middle], error[middle], atol=1e-9)
    assert 1e-5 < accuracy.worst < 1e-4
    down = pin.rpy.rpyToMatrix(0.0, math.pi, 0.0)
    angles = [np.linalg.norm(pin.log3(down.T @ one)) for one in turned]
    np.testing.assert_allclose(np.array(accuracy.orientation), angles, atol=1e-8)
    asked = ran.task.profile().sample(accuracy.times - begin).distance
    way = RADIUS * np.unwrap(np.arctan2(flat[:, 1], flat[:, 0]))
    np.testing.assert_allclose(np.array(accuracy.along_track)[middle], (way - asked)[middle], atol=1e-8)
    assert path_accuracy(shipped.robot, ran.task, ran.times, ran.slow.joint_states[:, 0]).worst == accuracy.worst
    # The path that the set-points describe is the circle, whether they are known to be one or not.
    joints, setpoints = ran.slow.joint_states[:, 0], ran.slow.reference[:, 0]
    followed = followed_accuracy(shipped.robot, ran.times, joints, ran.times, setpoints)
    assert np.abs(followed.times[[0, -1]] - accuracy.times[[0, -1]]).max() < 0.01
    rows = np.isin(accuracy.times, followed.times)
    # Between set-points the tip is taken to go straight: chords are nearer to the centre, and shorter, than the arc.
    chord = 1e-3 * 0.1
    nearer, shorter = chord**2 / (8.0 * RADIUS), circle.length * (chord / RADIUS) ** 2 / 24.0
    for name, most in (("perpendicular", 1.01 * nearer), ("along_track", 1.01 * shorter), ("orientation", 1e-7)):
        ours, theirs = (np.asarray(getattr(one, name)) for one in (followed, accuracy))
        np.testing.assert_allclose(ours[100:-250], theirs[rows][100:-250], atol=most)
    still = followed_accuracy(shipped.robot, ran.times, joints, ran.times, np.tile(setpoints[0], (len(joints), 1)))
    assert not len(still.times)


@pytest.mark.parametrize("joints", [5, 7])
def test_arms_of_five_and_seven_joints_travel_arcs(tmp_path: File, joints: int) -> None:
    """By Pinocchio their tool stays on the circle; of seven joints it keeps its orientation, of five its axis."""
    robot: RobotModel = robot_of_urdf(write_urdf(tmp_path, joints), JOINTS[:joints])
    posture = np.array(POSTURE[:joints])
    begin = tip_pose(robot, posture)
    place, turn = begin[:3, 3], begin[:3, :3]
    center = place + np.array([0.0, 0.04, 0.0])
    path = Path(
        tuple(place), (Segment((tuple(place),), "arc", center=tuple(center)),), 0.1, 1.0, 10.0,
        start_rpy=tuple(pin.rpy.matrixToRpy(turn)), start_posture=tuple(posture), singularity_margin=0.01,
    )  # fmt: skip
    plan = plan_line(robot, path)
    for q in plan.setpoints(np.linspace(0.5, plan.duration - 0.5, 200))[:, 0]:
        pose = tip_pose(robot, q)
        off = pose[:3, 3] - center
        assert max(abs(np.linalg.norm(off) - 0.04), abs(off[2])) < 2e-7
        here = pose[:3, :3]
        assert np.linalg.norm(here[:, 2] - turn[:, 2] if joints == 5 else pin.log3(here.T @ turn)) < 1e-6


START = (0.6, -0.1, 0.2)
LINE = Segment(((0.6, 0.1, 0.2),))
REFUSED = {
    "a line of no length": (lambda: Path(START, (Segment((START,)),)), r"segment 0 \(line\) starts and ends at"),
    "points on a line": (
        lambda: Path(START, (Segment(((0.6, 0.0, 0.2), (0.6, 0.1, 0.2)), "arc"),)), "on one line; accepted: three"),
    "a centre elsewhere": (
        lambda: Path(START, (Segment(((0.6, 0.1, 0.2),), "arc", (0.6, 0.02, 0.2)),)), "0.12 and 0.08 m from there"),
    "a zone too long": (
        lambda: Path(START, (replace(LINE, zone=0.2), Segment(((0.7, 0.1, 0.2),)))), "0.2 m; accepted: up to 0.05"),
    "a zone at the end": (lambda: Path(START, (replace(LINE, zone=0.01),)), "zone at the end of the path"),
    "a corner under a tool that turns": (
        lambda: Path(START, (LINE, Segment(((0.7, 0.1, 0.2),))), orientation="tangent"), "corner at 0.2 m; accepted"),
    "a turn that is not interpolated": (
        lambda: Path(START, (replace(LINE, end_rpy=(0.0, 3.0, 0.0)),)), "accepted: with the orientation interpolated"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_path_is_refused_with_its_place(name: str) -> None:
    make, said = REFUSED[name]
    with pytest.raises(LineError, match=said) as refusal:
        make()
    assert "\n" not in str(refusal.value)


def test_the_command_writes_the_trajectory_that_the_engine_runs(
    shipped: Setup, circle: Path, tmp_path: File, capsys: pytest.CaptureFixture[str]
) -> None:
    """`rx90 path --output` writes the points of `plan_path`, and refuses a file that is none with code 2, one line."""
    file = tmp_path / "circle.yaml"
    assert run("rx90 path", ["paths/circle.yaml", "--dry-run", "--output", str(file)]) == 0
    assert "path      0.3142 m at 0.1 m/s, 1 m/s^2" in capsys.readouterr().out
    written, planned = load_trajectory(file, shipped.robot.joint_names), plan_path(shipped, circle).points
    np.testing.assert_array_equal(written.position, planned.position)
    np.testing.assert_allclose(written.times, planned.times, atol=1e-12)
    bad = tmp_path / "bad.yaml"
    bad.write_text("path: {start: [0, 0, 0], segments: [{line: {end: [1, 0]}}], speed: 0.1, acceleration: 1.0, "
                   "tool_rpy_degrees: [0, 180, 0]}\n")  # fmt: skip
    assert run("rx90 path", [str(bad), "--dry-run"]) == 2
    error = capsys.readouterr().err
    assert re.fullmatch(r"rx90 path: .*segments\[0\].*accepted: a list of 3 numbers\n", error)
