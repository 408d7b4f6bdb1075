"""What a target cannot hold is fitted, and its cost said, and what it can is copied, for each target."""

import math
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
import yaml
from scipy.optimize import differential_evolution

import rx90_emulator as rx
from benchmarks.any_arm import write_arm
from rx90_common.base.errors import DONE, REFUSED, VERDICT_NO
from rx90_emulator.cli.frame import run
from rx90_emulator.export.fit import fit_friction, speeds_up_to
from rx90_emulator.export.targets import TARGETS

LUGRE = rx.FrictionElement(tau_c=25.0, tau_s=32.0, omega_s=0.05, delta=2.0, c0=1e5, c1=100.0, c2=14.0)
SPEEDS = speeds_up_to(4.0)


def test_what_a_target_holds_is_copied() -> None:
    """One sign, delta 2: MuJoCo gets the parameters to the last bit, and nothing is lost."""
    fit = fit_friction(TARGETS["mujoco"], "joint", [LUGRE], SPEEDS)
    law = fit.law
    assert (law.c0, law.c1, law.tau_c, law.tau_s, law.omega_s) == (1e5, 100.0, 25.0, 32.0, 0.05)
    assert law.viscous == (14.0, 0.0, 0.0)
    assert fit.largest < 1e-12
    assert fit.lost == ()


def test_two_signs_cost_half_of_their_difference() -> None:
    """The mean of both signs is nearest; what is left is half of what they differ by."""
    element = LUGRE.with_parameters({"tau_c_negative": 21.0, "tau_s_negative": 28.0})
    fit = fit_friction(TARGETS["mujoco"], "joint", [element], SPEEDS)
    assert (fit.law.tau_c, fit.law.tau_s) == (23.0, 30.0)
    assert (fit.largest, fit.rms) == pytest.approx((2.0, 2.0))
    assert any("signs" in line for line in fit.lost)


def test_no_law_of_the_target_is_nearer() -> None:
    """A global search over MuJoCo's parameters finds no smaller RMS difference for delta 0.8 and exponent 0.7."""
    element = LUGRE.replaced(delta=0.8, alpha=0.7)
    fit = fit_friction(TARGETS["mujoco"], "joint", [element], SPEEDS)
    torque = element.steady_torque(SPEEDS)

    def rms(x: np.ndarray) -> float:
        tau_c, rise, omega_s, p, q, r = x
        viscous = SPEEDS * ((p + q * SPEEDS) ** 2 + r * SPEEDS)
        return float(np.sqrt(np.mean((tau_c + rise * np.exp(-((SPEEDS / omega_s) ** 2)) + viscous - torque) ** 2)))

    bounds = [(10, 40), (0, 20), (5e-3, 1.0), (0, 8), (-3, 3), (0, 10)]
    best = differential_evolution(rms, bounds, seed=1, maxiter=120, popsize=8, tol=1e-6)
    assert fit.rms <= 1.02 * best.fun
    linear = fit_friction(TARGETS["mujoco"], "joint", [LUGRE.replaced(delta=0.8)], SPEEDS)
    assert linear.law.viscous[1:] == (0.0, 0.0)
    a, b, c = fit.law.viscous
    fast = np.geomspace(1e-3, 1e3, 200)
    assert (a + fast * (b + c * fast) >= -1e-12).all()  # takes power at every speed


def test_step_laws_keep_the_break_away_torque() -> None:
    """Isaac's friction while sliding is fitted, its break-away torque is that of the element."""
    fit = fit_friction(TARGETS["isaaclab"], "joint", [LUGRE], SPEEDS)
    x = np.column_stack([np.ones_like(SPEEDS), SPEEDS])
    coulomb, viscous = np.linalg.lstsq(x, LUGRE.steady_torque(SPEEDS), rcond=None)[0]
    assert (fit.law.tau_c, fit.law.viscous[0]) == pytest.approx((coulomb, viscous), rel=1e-6)
    assert fit.break_away == ((32.0, 32.0), (32.0, 32.0))
    assert math.isinf(fit.stiffness[1])


@pytest.mark.parametrize(
    ("robot", "target", "speeds"),
    [("rx90b", "urdf", None), ("rx90b", "sdf", (0.01, 1.0)), ("rx90b", "isaaclab", (0.5, 2.0)), ("tx40", "urdf", None)],
)
def test_errors_of_the_wrist_where_its_speeds_cancel(
    robot: str, target: str, speeds: tuple[float, float] | None
) -> None:
    """No pair of speeds, dense or such that the motor of both all but rests, is off by more than what is stated."""
    setup = rx.load_setup(robot=robot)
    export = rx.export_robot(setup, target, speeds=speeds)
    for joint, other in ((4, 5), (5, 4)):
        fit = export.fits[joint]
        least, most = speeds or (1e-3, setup.robot.max_velocity[joint])
        there_least, there_most = speeds or (1e-3, setup.robot.max_velocity[other])
        own = np.append(np.geomspace(least, most, 500), np.clip(there_most, least, most))[:, None]
        there = np.broadcast_to(np.geomspace(there_least, there_most, 900), (501, 900))
        cancelling = np.clip(own, there_least, there_most) + np.array([-1e-9, 1e-9, -1e-6, 1e-6])
        pairs = own + np.hstack([there, -there, -cancelling])
        highest = changed = 0.0
        for sign in (-1.0, 1.0):
            shared = setup.friction["joint_5_6"].steady_torque(sign * pairs)
            alone = setup.friction["joint_5_6"].steady_torque(sign * own)
            changed = max(changed, float(np.abs(shared - alone).max()))
            torque = setup.friction.elements[joint].steady_torque(sign * own) + shared
            off = torque - sign * (fit.law.tau_c + own * fit.law.viscous[0])
            highest = max(highest, float(np.abs(off).max()))
        assert highest * (1.0 - 1e-4) <= fit.worst <= highest * (1.0 + 1e-3)
        assert fit.coupled == pytest.approx(changed, rel=1e-3)
        moves = setup.robot.joint_names[other]
        assert f"coupling: while {moves} moves, joint_5_6 differs by up to {fit.coupled:.3g} Nm more" in fit.lost
        assert yaml.safe_load(export.report())["friction"][fit.name]["largest_while_others_move"] == fit.worst
    assert export.largest == max(fit.worst for fit in export.fits)


def test_errors_of_a_motor_that_turns_with_three_joints(tmp_path: Path) -> None:
    """Its row has another sign and a share: random speeds of the joints come near the stated error, none beyond it."""
    coupling = [*np.eye(7)[:6].tolist(), [0, 0, 0, 0, 1, -0.5, 1]]
    setup = rx.load_setup(robot=write_arm(tmp_path / "arm", 7, coupling))
    fit = rx.export_robot(setup, "urdf", speeds=(1e-3, 2.0)).fits[5]
    rng = np.random.default_rng(5)
    speeds = np.geomspace(1e-3, 2.0, 60)
    five, six, seven = rng.choice(np.concatenate([-speeds, speeds, [-2.0, 2.0] * 20]), (3, 200_000))
    shared = setup.friction.elements[7].steady_torque(five - 0.5 * six + seven)
    torque = setup.friction.elements[5].steady_torque(six) - 0.5 * shared
    most = float(np.abs(torque - np.sign(six) * fit.law.torque(np.abs(six))).max())
    assert 0.97 * fit.worst < most <= fit.worst * (1.0 + 1e-3)


def test_verdict_and_refusals(shipped_files: rx.RobotFiles, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 1 where a torque differs by more than was asked for; bad input is one line, and writes nothing."""
    words = ["mujoco", "--robot", "tx40"]
    assert run("rx90 export", [*words, "--output", str(tmp_path / "a"), "--within", "10"]) == DONE
    assert (tmp_path / "a" / "export.yaml").is_file()
    words = ["isaaclab", "--robot", "tx40"]
    assert run("rx90 export", [*words, "--output", str(tmp_path / "b"), "--within", "0.01"]) == VERDICT_NO
    assert "joint_5 differs by up to 11.8 Nm; accepted: 0.01 Nm" in capsys.readouterr().err
    shape = tmp_path / "shape.yaml"
    text = shipped_files.friction.read_text(encoding="utf-8")
    shape.write_text(f"{text}identification: {{speeds: {{joint_1: 3}}}}\n", encoding="utf-8")
    for more, reason in (
        (["--speeds", "2", "1"], "speeds from 2 to 1 rad/s; accepted"),
        (["--speeds", "1e-300", "1"], "speeds from 1e-300 to 1 rad/s; accepted: two numbers from 1e-06 to 10000"),
        (["--friction", str(shape)], "shape.yaml: its identification has another shape; accepted: as"),
    ):
        assert run("rx90 export", ["urdf", "--output", str(tmp_path / "c"), *more]) == REFUSED
        assert reason in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "c").exists()


def test_no_controller_is_needed(tmp_path: Path) -> None:
    """A folder without controller.yaml is exported, over the speeds at which excitation runs identified friction."""
    folder = write_arm(tmp_path / "arm", 2)
    (folder / "controller.yaml").unlink()
    file = rx.FrictionFile.read(folder / "friction.yaml")
    found = file.replaced(identification={"speeds": {"arm_2": [0.02, 1.5]}})
    (folder / "friction.yaml").write_text(found.text(), encoding="utf-8")
    assert run("rx90 export", ["mujoco", "--robot", str(folder), "--output", str(tmp_path / "out")]) == DONE
    fits = yaml.safe_load((tmp_path / "out" / "export.yaml").read_text(encoding="utf-8"))["friction"]
    assert fits["arm_2"]["speeds"] == pytest.approx([0.02, 1.5])
    assert fits["arm_1"]["speeds"] == pytest.approx([1e-3, 3.0])


def one_file(setup: rx.Setup, target: str) -> str:
    (text,) = rx.export_robot(setup, target).files.values()
    return text


@pytest.fixture(scope="module", params=["rx90b", "panda"])
def robot(request: pytest.FixtureRequest) -> rx.Setup:
    return rx.load_setup(robot=request.param)


def test_pinocchio_reads_friction_from_the_urdf(robot: rx.Setup) -> None:
    """Its damping and friction are those of the fit, its arm that of the setup."""
    export = rx.export_robot(robot, "urdf")
    model = pin.buildModelFromXML(one_file(robot, "urdf"))
    assert model.damping == pytest.approx([fit.law.viscous[0] for fit in export.fits], rel=1e-12)
    assert model.friction == pytest.approx([fit.law.tau_c for fit in export.fits], rel=1e-12)
    ours = robot.robot.model
    q = np.linspace(-0.8, 1.1, ours.nq)
    assert pin.crba(model, model.createData(), q) == pytest.approx(pin.crba(ours, ours.createData(), q))


def placed_frame(model: ET.Element, placed: Callable[[str], pin.SE3], name: str) -> pin.SE3:
    frame = next((one for one in model.findall("frame") if one.get("name") == name), None)
    if frame is None:
        return placed(name)
    x = np.array([float(word) for word in frame.findtext("pose", "").split()])
    return placed_frame(model, placed, frame.get("attached_to", "")) * pin.SE3(pin.rpy.rpyToMatrix(x[3:]), x[:3])


def test_sdf_has_the_same_chain(robot: rx.Setup) -> None:
    """Poses composed as SDF says, relative to what they name, put links and axes where Pinocchio has them."""
    model = ET.fromstring(one_file(robot, "sdf"))[0]
    poses = {one.get("name", ""): one.find("pose") for one in model if one.get("name")}

    def placed(name: str) -> pin.SE3:
        pose = poses[name]
        if pose is None:
            return pin.SE3.Identity()
        x = np.array([float(word) for word in (pose.text or "0 0 0 0 0 0").split()])
        above = placed(pose.get("relative_to", ""))
        return above * pin.SE3(pin.rpy.rpyToMatrix(x[3:]), x[:3])

    ours = robot.robot.model
    data = ours.createData()
    pin.framesForwardKinematics(ours, data, np.zeros(ours.nq))
    for k, name in enumerate(robot.robot.joint_names):
        joint = next(one for one in model.findall("joint") if one.get("name") == name)
        assert placed(joint.findtext("child", "")).translation == pytest.approx(data.oMi[k + 1].translation)
        axis = placed(name).rotation @ [float(word) for word in joint.findtext("axis/xyz", "").split()]
        assert axis == pytest.approx(robot.robot.chain.axis[k])
    tcp = robot.robot.tcp_frame
    there = data.oMf[ours.getFrameId(tcp)].homogeneous
    assert placed_frame(model, placed, tcp).homogeneous == pytest.approx(there, abs=1e-12)
    mass = sum(float(one.text or 0) for one in model.iter("mass"))
    assert mass == pytest.approx(pin.computeTotalMass(ours) + ours.inertias[0].mass)


@pytest.fixture
def isaac(monkeypatch: pytest.MonkeyPatch) -> None:
    package, actuators = ModuleType("isaaclab"), ModuleType("isaaclab.actuators")
    actuators.ImplicitActuatorCfg = SimpleNamespace  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "isaaclab", package)
    monkeypatch.setitem(sys.modules, "isaaclab.actuators", actuators)


@pytest.mark.usefixtures("isaac")
def test_the_module_for_isaac_lab_runs(shipped: rx.Setup) -> None:
    """It gives break-away, sliding and viscous friction for each joint by its name."""
    export, found = rx.export_robot(shipped, "isaaclab"), {}
    exec(one_file(shipped, "isaaclab"), found)
    config = found["RX90B_ACTUATORS"]
    for fit in export.fits:
        got = [values[fit.name] for values in (config.friction, config.dynamic_friction, config.viscous_friction)]
        assert got == [fit.law.tau_s, fit.law.tau_c, fit.law.viscous[0]]
    assert config.armature["joint_5"] == pytest.approx(shipped.drives.rotor_matrix[4, 4])


HOSTILE = """x\"\"\"; raise SystemExit('hostile') # \\ & ' {{ 7 * 7 }} ]]> --> <i/>\U0001f980"""


@pytest.mark.usefixtures("isaac")
@pytest.mark.parametrize("target", TARGETS)
def test_names_are_quoted_for_the_language_that_they_go_into(target: str, tmp_path: Path) -> None:
    """No name of a robot, a link or a joint is code in any file, and each is read back as it was."""
    folder = write_arm(tmp_path / "arm", 2)
    file = folder / "robot.urdf"
    root = ET.fromstring(file.read_text(encoding="utf-8"))
    names = {root.get("name", ""): HOSTILE, "arm_1": f"joint {HOSTILE}"}
    for element in root.iter():
        element.set("name", names.get(element.get("name", ""), element.get("name", "")))
    file.write_text(ET.tostring(root, encoding="unicode"), encoding="utf-8")
    friction = yaml.safe_load((folder / "friction.yaml").read_text(encoding="utf-8"))
    friction["elements"] = {names.get(name, name): values for name, values in friction["elements"].items()}
    (folder / "friction.yaml").write_text(yaml.safe_dump(friction), encoding="utf-8")
    export = rx.export_robot(rx.load_setup(robot=folder), target)
    ((name, text),) = export.files.items()
    assert "/" not in name
    if target == "isaaclab":
        module: dict[str, object] = {}
        exec(text, module)
        assert HOSTILE in str(module["__doc__"])
        (config,) = (value for key, value in module.items() if key.endswith("ACTUATORS"))
        first, _ = config.friction  # type: ignore[attr-defined]
        assert re.fullmatch(first, names["arm_1"])
    else:
        read = ET.fromstring(text)
        assert {names["arm_1"]} <= {element.get("name", "") for element in read.iter()}
