"""Planned excitation runs: within every limit, better than random ones, the same again, recognised when recorded."""

import io
import xml.etree.ElementTree as ET
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from grip_arm import JOINTS, write_urdf
from scipy.interpolate import BPoly

import rx90_emulator as rx
from rx90_common.base.arrays import Array
from rx90_common.base.errors import DONE, REFUSED, IdentificationError
from rx90_common.description.wall import Wall
from rx90_common.description.workspace import Workspace
from rx90_emulator.cli.frame import run
from rx90_emulator.identification.excitation import identify_excitation
from rx90_emulator.identification.experiments.arms import PlannedArm
from rx90_emulator.identification.experiments.excitation import ExcitationSearch, plan_excitation
from rx90_emulator.identification.experiments.options import ExcitationOptions
from rx90_emulator.identification.experiments.plan import Experiment, Kind, read_index, write_index
from rx90_emulator.identification.experiments.series import run_on_engine
from rx90_emulator.identification.options import RobotOptions
from rx90_emulator.loop.setup import Setup

pytestmark = pytest.mark.slow

TABLE, WALL = 0.12, (-1.0, -0.5, 0.0, -0.45)
OPTIONS = ExcitationOptions(
    period=3.0, harmonics=5, tempos=((1.0, 3),), steps=8, seed=2, walls=(Wall.above(TABLE), Wall.through(WALL))
)


@pytest.fixture(scope="module")
def plan(tx40: Setup) -> tuple[Experiment, ...]:
    return plan_excitation(PlannedArm.from_setup(tx40), OPTIONS)[0]


@pytest.fixture(scope="module")
def motion(plan: tuple[Experiment, ...]) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration of its trajectory, by SciPy's quintics, at 1 kHz."""
    points = plan[0].points
    knots = np.stack([points.position, points.velocity, points.acceleration], axis=1)
    curve = BPoly.from_derivatives(points.times, knots)
    time = np.arange(0.0, points.times[-1], 1e-3)
    return curve(time), curve(time, nu=1), curve(time, nu=2)


def test_a_run_keeps_every_limit(plan: tuple[Experiment, ...], motion: tuple[Array, Array, Array], tx40: Setup) -> None:
    """The whole trajectory keeps ranges, speeds, accelerations and torques of joints and motors, by Pinocchio."""
    robot, drives, controller = tx40.robot, tx40.drives, tx40.controller
    position, velocity, acceleration = motion
    turns = np.eye(6)
    turns[5, 4] = 1.0
    assert np.all((robot.lower <= position) & (position <= robot.upper))
    assert np.all(np.abs(velocity) <= 0.8 * robot.max_velocity)
    assert np.all(np.abs(velocity @ turns.T) <= 0.8 * robot.max_velocity)
    assert np.all(np.abs(acceleration) <= 0.8 * controller.max_acceleration)
    # Some joint comes near to a limit: the motion is not safe by being small.
    assert np.abs(acceleration / controller.max_acceleration).max() > 0.75
    most, switch = np.abs(drives.gear) * drives.peak_torque, controller.feed_forward
    data, shares = robot.model.createData(), []
    for q, v, a in zip(*(one[::20] for one in motion), strict=True):
        motor = turns @ v
        friction = np.sign(motor) * (switch.coulomb_torque + np.multiply(switch.viscous_friction, np.abs(motor)))
        torque = pin.rnea(robot.model, data, q, v, a) + turns.T @ (drives.rotor_inertia * (turns @ a) + friction)
        assert np.all(np.abs(torque) <= 0.8 * robot.max_effort)
        shares.append(np.abs([motor / robot.max_velocity, np.linalg.solve(turns.T, torque) / most]))
    greatest = np.max(shares, axis=0)
    assert greatest[1].max() <= 0.8
    used = PlannedArm.from_setup(tx40).check(plan[0])
    assert [used[name][0] for name in ("motor speed", "motor torque")] == pytest.approx(greatest.max(axis=1), abs=0.01)


def test_every_shape_stays_away_from_table_and_wall(
    plan: tuple[Experiment, ...], motion: tuple[Array, Array, Array], tx40: Setup
) -> None:
    """Corners of boxes, rims of cylinders and points of spheres, placed by Pinocchio, keep the clearance."""
    normal = np.array(WALL[:3]) / np.linalg.norm(WALL[:3])
    planes = [(np.array([0.0, 0.0, 1.0]), TABLE), (normal, WALL[3] / float(np.linalg.norm(WALL[:3])))]
    model, data = tx40.robot.model, tx40.robot.model.createData()
    least = [np.inf, np.inf]
    for q in motion[0][::100]:
        pin.framesForwardKinematics(model, data, q)
        for link in ET.fromstring(tx40.robot.urdf).findall("link"):
            frame = model.getFrameId(str(link.get("name")), pin.BODY)
            points = _outline(link) @ data.oMf[frame].rotation.T + data.oMf[frame].translation
            joint = _joint_of(model.frames[frame])
            for k, (direction, distance) in enumerate(planes):
                if joint > 2 and len(points):  # some shapes of the first two only turn in place
                    least[k] = min(least[k], float((points @ direction).min()) - distance)
    workspace = Workspace(tx40.robot, OPTIONS.walls, plan[0].points.position[0], OPTIONS.clearance)
    nearest = dict[str, float]()
    for pair, distance in zip(workspace.pairs, workspace.distances(motion[0][::100]).min(axis=0), strict=True):
        nearest[pair] = min(distance, nearest.get(pair, np.inf))
    links = ("link_3", "link_4", "link_5", "link_6", "tool")
    reported = [min(nearest.get(f"{link} to {wall.name}", np.inf) for link in links) for wall in OPTIONS.walls]
    assert min(least) >= OPTIONS.clearance
    assert np.all(np.array(least) - reported < 2e-3)
    assert np.all(np.array(least) - reported > -1e-9)


def _joint_of(frame: Any) -> int:
    """Return the number of the joint that moves a frame; Pinocchio 2 calls it `parent`."""
    return int(frame.parentJoint if hasattr(frame, "parentJoint") else frame.parent)


def _outline(link: ET.Element) -> Array:
    """Return corners, rims and points of a link's shapes in its frame, m, shape (k, 3)."""
    found = [np.zeros((0, 3))]
    turn, height = (grid.ravel() for grid in np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 49), np.linspace(-1.0, 1.0, 61)))
    circle = np.column_stack([np.cos(turn), np.sin(turn)])

    def numbers(text: str) -> Array:
        return np.array(text.split(), dtype=np.float64)

    for shape in link.findall("collision"):
        origin = shape.find("origin")
        places = {} if origin is None else origin.attrib
        xyz, rpy = (numbers(places.get(key, "0 0 0")) for key in ("xyz", "rpy"))
        (kind,) = shape.findall("geometry/*")
        if kind.tag == "sphere":
            ball = np.column_stack([circle * np.sqrt(1.0 - height**2)[:, None], height])
            points = ball * numbers(kind.get("radius", ""))
        elif kind.tag == "box":
            signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
            points = 0.5 * signs * numbers(kind.get("size", ""))
        else:
            rim = circle * numbers(kind.get("radius", ""))
            points = np.column_stack([rim, 0.5 * np.sign(height) * numbers(kind.get("length", ""))])
        found.append(points @ pin.rpy.rpyToMatrix(rpy).T + xyz)
    return np.vstack(found)


def _search(setup: Setup, walls: tuple[Wall, ...] = (), steps: int = 2) -> ExcitationSearch:
    options = ExcitationOptions(harmonics=5, period=6.0, walls=walls, steps=steps)
    return ExcitationSearch(PlannedArm.from_setup(setup, home=[0.0] * 6), options)


def test_a_motion_too_fast_for_motor_6_is_scaled(tx40: Setup) -> None:
    """Joints 5 and 6 at 95 % of the allowed speed are kept, one by one or against each other; together they shrink."""
    options = ExcitationOptions(harmonics=5, period=6.0, share=0.3)
    search = ExcitationSearch(PlannedArm.from_setup(tx40, home=[0.0] * 6), options)
    top = 0.3 * tx40.robot.max_velocity
    pattern = np.zeros((6, search.samples.shape[2]))
    pattern[4:, :4] = np.random.default_rng(0).normal(size=4)
    pattern[4:] *= 0.95 * (top / np.maximum(np.abs((search.samples @ pattern.T)[1]).max(axis=0), 1e-9))[4:, None]
    kept = {}
    for name, signs in (("5", (1, 0)), ("6", (0, 1)), ("against", (1, -1)), ("together", (1, 1))):
        coefficients = pattern * np.array([0, 0, 0, 0, *signs])[:, None]
        shrunk = search.within(coefficients)
        kept[name] = np.abs(shrunk).max() / np.abs(coefficients).max()
        velocity = search.motion(shrunk, search.basis(np.arange(0.0, 6.0, 1e-3)))[1]
        assert np.abs(velocity[:, 4] + velocity[:, 5]).max() <= top[5] * 1.001
    expected = top[5] / (0.95 * (top[4] + top[5]))
    assert kept == pytest.approx({"5": 1.0, "6": 1.0, "against": 1.0, "together": expected}, rel=0.04)


def test_an_optimised_run_tells_more_than_random_ones(shipped: Setup) -> None:
    """The parameters' mean deviation, by NumPy's determinant, is smaller than that of the best random one."""
    search, time = _search(shipped, steps=30), np.arange(0.0, 6.0, 0.02)

    def mean_deviation(coefficients: Array) -> float:
        rows = np.concatenate(search.rows(search.motion(coefficients, search.basis(time))))
        return float(np.exp(-np.linalg.slogdet(rows.T @ rows)[1] / (2.0 * rows.shape[1])))

    rng = np.random.default_rng(3)
    best = min(mean_deviation(search.within(search.random(rng))) for _ in range(3))
    assert mean_deviation(search.best(np.random.default_rng(4), lambda: None)) < 0.9 * best


def test_the_columns_are_all_that_the_torque_depends_on(shipped: Setup) -> None:
    """As many are independent as NumPy's rank of the torques of random links, rotors, offsets and friction."""
    search = _search(shipped)
    rng = np.random.default_rng(5)
    rows = np.concatenate(search.rows(rng.uniform(-2.0, 2.0, (3, 200, 6))))
    assert np.linalg.matrix_rank(rows / np.linalg.norm(rows, axis=0), 1e-7) == rows.shape[1]
    # 36 base parameters of links, of which 6 - 4 contain a rotor, 4 more rotors, 6 offsets, 7 elements of two.
    assert rows.shape[1] == 60


def test_the_search_goes_by_the_right_derivative(shipped: Setup) -> None:
    """The derivative of what is minimised, limits and walls exceeded, is that of differences."""
    search = _search(shipped, (Wall.above(0.3),))
    rng = np.random.default_rng(1)
    x = 3.0 * search.random(rng).ravel()
    speed = search.motion(x.reshape(6, -1), search.samples)[1]
    assert np.abs(speed[:, 4] + speed[:, 5]).max() > shipped.robot.max_velocity[5]
    direction = rng.normal(size=x.size)
    value, slope = search.cost(x)
    assert value > 10.0  # limits are exceeded
    difference = (search.cost(x + 1e-4 * direction)[0] - search.cost(x - 1e-4 * direction)[0]) / 2e-4
    assert slope @ direction == pytest.approx(difference, rel=2e-3)


def test_the_same_seed_gives_the_same_plan_and_another_one_another(tx40: Setup) -> None:
    """Slower tempos are the same path; another seed has another one."""
    arm = PlannedArm.from_setup(tx40)
    options = ExcitationOptions(harmonics=3, period=3.0, tempos=((1.0, 1), (0.5, 1)), steps=2)
    first, slower, unseen = plan_excitation(arm, options)[0]
    again = plan_excitation(arm, replace(options, tempos=((1.0, 1),)))[0][0]
    other = plan_excitation(arm, replace(options, seed=1))[0][0]
    assert np.array_equal(first.points.position, again.points.position)
    assert not np.allclose(first.points.position, other.points.position)
    assert unseen.kind is Kind.VALIDATION
    assert slower.duration - 0.3 == pytest.approx(2.0 * (first.duration - 0.3))
    assert np.ptp(slower.points.position, axis=0) == pytest.approx(np.ptp(first.points.position, axis=0), abs=1e-2)


def test_the_arm_does_not_touch_itself(shipped: Setup) -> None:
    """A motion that folds the arm onto its base, by Pinocchio's plain collisions, is shrunk until it is free."""
    search = _search(shipped)
    time = np.arange(0.0, 6.0, 0.02)
    fine = search.basis(time)
    folding = np.outer(1.0 - np.cos(2.0 * np.pi * time / 6.0), (0.0, 0.95, 1.05, 0.0, 0.0, 0.0))
    coefficients = np.linalg.lstsq(fine[0], folding, rcond=None)[0].T

    model = shipped.robot.model
    shapes = pin.buildGeomFromUrdfString(model, shipped.robot.urdf, pin.COLLISION)
    for k, shape in enumerate(shapes.geometryObjects):
        if _joint_of(model.frames[shape.parentFrame]) > 1:
            shapes.addCollisionPair(pin.CollisionPair(0, k))
    data = model.createData(), shapes, shapes.createData()

    def touches(coefficients: Array) -> bool:
        return any(pin.computeCollisions(model, *data, q, True) for q in search.motion(coefficients, fine)[0])

    assert touches(coefficients)
    assert search.workspace.nearness(search.motion(coefficients, fine)[0]).max() > 0.0
    free = search.within(coefficients)
    assert not touches(free)
    assert np.ptp(search.motion(free, fine)[0], axis=0).max() > 0.1


def test_a_folder_of_excitation_runs_is_identified_as_such(
    plan: tuple[Experiment, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`identify excitation FOLDER` takes runs and validation from the index; one of a series of sweeps names none."""
    runs = [plan[0], replace(plan[0], name="unseen", kind=Kind.VALIDATION)]
    write_index(tmp_path, runs[1:])
    (tmp_path / "unseen").mkdir()
    assert "excitation" not in (tmp_path / "experiments.yaml").read_text()
    assert read_index(tmp_path).excitation == ()
    (tmp_path / "excitation_1").mkdir()
    write_index(tmp_path, runs)
    seen: list[object] = []

    def refused(*given: object, **_: object) -> None:
        seen.append(given)
        raise IdentificationError("enough")

    monkeypatch.setattr(rx, "identify_excitation", refused)
    assert run("rx90 identify excitation", [str(tmp_path), "--output", str(tmp_path / "out")]) == REFUSED
    (given,) = seen
    assert (given[0], given[2]) == ((tmp_path / "excitation_1",), (tmp_path / "unseen",))  # type: ignore[index]


def test_a_planned_run_tells_the_inertias_that_the_engine_has(
    plan: tuple[Experiment, ...], tx40: Setup, tmp_path: Path
) -> None:
    """The wrist's rotors to 0.4 %, as a torque counted half a tick late would not tell; Coulomb friction to 0.5 %."""
    bag = tmp_path / "run"
    run_on_engine(tx40, plan[0], bag)
    result = identify_excitation([bag], RobotOptions(robot="tx40"), model=["coulomb-viscous"], bandwidth=150.0)
    base = {parameter.name: parameter.estimate.value for parameter in result.base}
    for k in (4, 5, 6):
        assert base[f"Ia_{k}"] == pytest.approx(tx40.drives.rotor_inertia[k - 1], rel=4e-3)
    for identified, law in zip(result.elements, tx40.friction.elements, strict=True):
        assert identified.element.tau_c.positive == pytest.approx(law.tau_c.positive, rel=5e-3)


ARM = ["--joints", *JOINTS]
SHORT = ["--quick", "--period", "6"]


def _plan(*words: str) -> int:
    return run("rx90 experiment excitation any", words)


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_urdf(tmp_path_factory.mktemp("arm"), continuous=True)


@pytest.fixture(scope="module")
def motions(urdf: Path) -> Path:
    folder = urdf.parent / "motions"
    with redirect_stdout(io.StringIO()) as said:
        assert _plan("--urdf", str(urdf), *ARM, *SHORT, "--output", str(folder), "--rate", "250") == DONE
    (folder / "said.txt").write_text(said.getvalue(), encoding="utf-8")
    return folder


def _knots(file: Path) -> tuple[list[str], Array, Array]:
    """Return names, times and knots, shape (n, 3, joints), of a trajectory file, by PyYAML."""
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    points = content["points"]
    times = [one["time_from_start"]["sec"] + 1e-9 * one["time_from_start"]["nanosec"] for one in points]
    knots = [[one[key] for key in ("positions", "velocities", "accelerations")] for one in points]
    return content["joint_names"], np.array(times), np.array(knots)


@pytest.mark.parametrize("name", ["excitation_1", "validation"])
def test_a_motion_keeps_the_limits_of_the_urdf(urdf: Path, motions: Path, name: str) -> None:
    """Ranges, 80 % of speeds, these in 0.5 s as accelerations, and efforts by Pinocchio's inverse dynamics are kept."""
    names, times, knots = _knots(motions / f"{name}.yaml")
    assert tuple(names) == JOINTS
    whole = pin.buildModelFromUrdf(str(urdf))
    others = [k for k, joint in enumerate(whole.names) if k and joint not in JOINTS]
    model = pin.buildReducedModel(whole, others, pin.neutral(whole))
    limits = [model.joints[k].idx_q for k in range(1, 8)]
    low, high = (np.append(one[limits[:6]], end) for one, end in (
        (model.lowerPositionLimit, -np.pi), (model.upperPositionLimit, np.pi)))  # fmt: skip
    at = np.arange(0.0, times[-1], 5e-3)
    curve = BPoly.from_derivatives(times, list(knots))
    q, v, a = (curve(at, nu=order) for order in range(3))
    assert np.all((low <= q) & (q <= high))
    speed = model.velocityLimit[:7]
    shares = [np.abs(v / speed), np.abs(a / (speed / 0.5))]
    data = model.createData()
    torque = [
        pin.rnea(model, data, np.concatenate([row[:6], [np.cos(row[6]), np.sin(row[6])]]), *rest)
        for row, *rest in zip(q, v, a, strict=True)
    ]
    shares.append(np.abs(np.array(torque) / model.effortLimit[:7]))
    assert np.max(shares) <= 0.8 * 1.001
    assert np.max(shares) > (0.7 if name == "excitation_1" else 0.4)  # the validation is not optimised
    home = 0.5 * (low + high)
    np.testing.assert_allclose(
        knots[[0, -1]], np.stack([home, np.zeros(7), np.zeros(7)])[None].repeat(2, 0), atol=1e-12
    )


def test_the_table_of_set_points_is_the_trajectory(motions: Path) -> None:
    """Each row of the CSV is SciPy's quintic through the knots of the YAML, at 250 Hz, in named columns."""
    file = motions / "excitation_1.csv"
    head = file.read_text().splitlines()[0].split(",")
    rows = np.loadtxt(file, delimiter=",", skiprows=1)
    names, times, knots = _knots(motions / "excitation_1.yaml")
    quantities = ("position [rad]", "velocity [rad/s]", "acceleration [rad/s^2]")
    assert head == ["time [s]", *(f"{name} {what}" for what in quantities for name in names)]
    curve = BPoly.from_derivatives(times, list(knots))
    np.testing.assert_allclose(rows[:, 0], np.arange(len(rows)) / 250.0, atol=1e-9)
    assert times[-1] - rows[-1, 0] < 1.0 / 250.0
    inside = rows[:, 0] < times[-1]
    for order in range(3):
        there = curve(rows[inside, 0], nu=order)
        np.testing.assert_allclose(rows[inside, 1 + 7 * order : 8 + 7 * order], there, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(
    ("words", "change", "said"),
    [
        ([], (), "accepted: revolute and continuous joints with a drive of their own, --joints"),
        ([*ARM, "--home", *["0"] * 7], (), "home: arm_4 is 0 rad; accepted: [-3.1, -0.07]"),
        ([*ARM, "--keep-above", "1.5"], (), "even of a small one tip to --keep-above 1.5 is too near; accepted: walls"),
        (ARM, ('effort="90"', 'effort="0"'), "joint 'arm_1' limit has velocity 2.2 and effort 0; accepted"),
    ],
)
def test_what_does_not_fit_the_arm_is_refused(
    urdf: Path, tmp_path: Path, words: list[str], change: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Options, and limits that plan nothing, are one line with the value and what is accepted, and exit code 2."""
    file = tmp_path / "arm.urdf"
    file.write_text(urdf.read_text(encoding="utf-8").replace(*change) if change else urdf.read_text(encoding="utf-8"))
    assert _plan("--urdf", str(file), *SHORT, *words) == REFUSED
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    assert said in error[0]
