"""Published and identified friction: numbers carried to the joint, and the library of sets.

Sources of the published, with the revision that was read: petercorke/robotics-toolbox-python a9ed8d45 (MIT),
models/DH/Puma560.py; modelica/ModelicaStandardLibrary b756f9de (BSD-3-Clause),
Mechanics/MultiBody/Examples/Systems/RobotR3/FullRobot.mo; shamilmamedov/dynamic_calibration 11af40e7,
UR10E_parameters.txt; unisa-acg/inverse-dynamics-solver 41e196de (BSD-3-Clause), ur10_inverse_dynamics_solver.{h,cpp};
Rhoban/bam 1b5a1cee (Apache-2.0), bam/params.
"""

import math
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.optimize import brentq, nnls

from friction_bench.rig.rig_file import load_rig
from rx90_common.base.arrays import Array
from rx90_common.base.config import read_yaml, yaml_text
from rx90_common.base.share import config_path
from rx90_common.friction.friction_file import FrictionFile

SIX_DIGITS = 5e-6


class Sliding(NamedTuple):
    """What a source gives of an element, at the joint: torques for both signs, Nm, and its Stribeck part, if any."""

    coulomb: tuple[float, float]
    viscous: float
    static: float | None = None
    omega_s: float | None = None
    delta: float | None = None


# At the motors: |G|, Coulomb torque for positive and for negative joint speed (Nm), viscous friction (Nm s/rad).
PUMA = (
    (62.6111, 0.395, 0.435, 1.48e-3),
    (107.815, 0.126, 0.071, 0.817e-3),
    (53.7063, 0.132, 0.105, 1.38e-3),
    (76.0364, 11.2e-3, 16.9e-3, 71.2e-6),
    (71.923, 9.26e-3, 14.5e-3, 82.6e-6),
    (76.686, 3.96e-3, 10.5e-3, 36.7e-6),
)
# At the motors: ratio, Rv0 (Nm), Rv1 (Nm s/rad).
R3_INNER = ((-105.0, 0.4, 0.13 / 160), (210.0, 0.5, 0.1 / 130), (60.0, 0.7, 0.2 / 130))
# At the joints: Rv0 (Nm), Rv1 (Nm s/rad), peak.
R3_OUTER = ((21.8, 9.8, 26.7 / 21.8), (30.1, 0.03, 39.6 / 30.1), (10.9, 3.92, 16.8 / 10.9))
PARTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
UR_JOINTS = tuple(f"{name}_joint" for name in PARTS)
# At the joints: Fv (Nm s/rad), Fc (Nm).
UR10E = (
    (21.2560035178975, 12.5483919746119),
    (20.2209078488147, 13.2656448586672),
    (10.3777424977617, 4.99431320112810),
    (3.57505079619634, 1.99785409182665),
    (2.49090134851989, 2.69046065664555),
    (3.02555317117942, 2.29785428883088),
)
# K (Nm/A), f_v (A s/rad), f_o, f_c (A), alpha (s/rad), nu (rad/s) of f_v v + f_o + f_c / (1 + exp(-alpha (v + nu))).
UR10 = (
    (13.5841, 1.064043537306522, -1.006569687742683, 2.050627184327219, 7.946667188885291, -0.018479435103176),
    (14.2959, 0.994406350204483, 0.956270099079205, -2.401744448718348, -59.95355152110444, -0.001949874917063),
    (11.3716, 0.679578357403764, -0.811994879948593, 1.64784235905507, 19.82513907637678, -0.005295096397544),
    (11.2408, 0.315921846615047, -0.176720084521011, 0.468777484116134, 134.8982492898554, -0.018576852000623),
    (11.7681, 0.224394888674796, -0.192362457059083, 0.475975499951034, 331.4420553811227, -0.011778095526897),
    (11.7682, 0.235839271499783, -0.245334512427042, 0.597950406691004, 459.1933488839184, -0.012953200294568),
)
# friction_base, friction_viscous; of m2 friction_stribeck, dtheta_stribeck and alpha besides.
BAM = {
    "erob80_50": {
        "m1": (4.096647502063686, 1.29805795295293),
        "m2": (4.086230363954603, 1.3131993446070485, 1.6504871346024715e-08, 0.9617768749469398, 1.438935728332229),
    },
    "erob80_100": {
        "m1": (5.610965892410754, 8.392324354671375),
        "m2": (1.4462862541212224e-10, 9.570659122263434, 5.455188967669691, 2.079758511184917, 2.99999673058633),
    },
}


# Of m3 to m6: K_c, K_cs, K_m, K_e, K_ms, K_es (K_l and K_ls of m3 and m4 for both), K_mq, K_eq, K_v, w_s, alpha.
BY_LOAD = ("m3", "m4", "m5", "m6")
BAM_LOAD = {
    "erob80_50": (
        (3.46658012152533, 0.0, *2 * (0.06292192512694414,), 0.0, 0.0, 0.0, 0.0, 1.207272265635136, 1.0, 1.0),
        (3.453696652879759, 9.218443879044224e-06, *2 * (0.06308728641180934,), *2 * (7.125720330621117e-07,),
         0.0, 0.0, 1.216634943303125, 0.34601387316221976, 2.727164024161143),
        (2.3673298244088454, 0.8379934972683746, 0.03418184370369529, 0.00026790940844419897, 0.015404277930421264,
         0.08496269863014352, 0.0, 0.0, 1.6088820042966994, 2.263893998051299, 2.984725791735308),
        (3.258936577427873, 0.32043116640097835, 0.03566185222966088, 0.0008431659435708802, 0.003770985236415064,
         0.041438023645284434, 0.0018721192347735344, 0.0015990991138724365, 1.403394119501813, 2.830385649014235,
         1.7864364677651365),
    ),
    "erob80_100": (
        (4.83228100668814, 0.0, *2 * (0.14798087840990956,), 0.0, 0.0, 0.0, 0.0, 7.395263062846597, 1.0, 1.0),
        (0.0001250620234780261, 4.381669778040507, *2 * (2.126815651171455e-06,), *2 * (0.1661425164008433,),
         0.0, 0.0, 9.02901791728356, 1.977086206494623, 2.9999261411563274),
        (0.0008544416565456324, 3.8971701985820273, 0.0014386633405137944, 3.392293448680981e-06, 7.95025355007889e-05,
         0.2544739333707678, 0.0, 0.0, 8.888393828048388, 1.8499219470996635, 2.999117024168752),
        (0.0004779665335836211, 5.2264235087217585, 0.048887727723564756, 7.626323416955297e-08, 8.823275901433639e-06,
         0.05116664604344119, 0.0027029166135035076, 0.002556257557735874, 9.709332392870175, 2.0330344391978556,
         2.9999247237894795),
    ),
}  # fmt: skip


def bam_friction(model: Sequence[float], load: float, v: float, *, driving: bool) -> float:
    """Return the friction of BAM's models, which stands on both sides, in steady sliding under a load, Nm."""
    kc, kcs, km, ke, kms, kes, kmq, keq, kv, w_s, alpha = model
    s = math.exp(-((v / w_s) ** alpha))

    def surplus(friction: float) -> float:
        motor, external = (load + friction, -load) if driving else (friction - load, load)
        square = keq * external**2 if abs(external) < abs(motor) else kmq * motor**2
        opposed = motor * external < 0.0
        gear, stribeck = abs(km * motor - ke * external), kcs + abs(kms * motor - kes * external) + square * opposed
        return kc + kv * v + gear + s * stribeck - friction

    return float(brentq(surplus, 0.0, 1e6, xtol=1e-13, rtol=1e-13))


LOADS, SPEEDS = range(0, 81, 2), [0.25 * k for k in range(13)]  # where the load part is held against BAM, Nm and rad/s


@lru_cache
def bam_points(model: Sequence[float], *, driving: bool) -> Array:
    """Return loads, speeds and BAM's friction, shape (3, n); driven, where the load is more, and moves the motor."""
    points = [(load, v, bam_friction(model, load, v, driving=driving)) for load in LOADS for v in SPEEDS]
    return np.array([(load, v, friction) for load, v, friction in points if driving or friction < load]).T


def fitted_driven(model: Sequence[float]) -> Array:
    """Return driven, stribeck_driven and quadratic_driven that come nearest to BAM, relative to it, shape (3,)."""
    kc, kcs, km, _, kms, _, kmq, _, kv, w_s, alpha = model
    load, v, friction = bam_points(model, driving=False)
    s = np.exp(-((v / w_s) ** alpha))
    coulomb, static = kc / (1.0 - km), (kc + kcs) / (1.0 - km - kms)
    unloaded = coulomb + (static - coulomb) * s + kv / (1.0 - km) * v
    columns = np.array([load, s * load * (kms > 0.0), s * load**2 * (kmq > 0.0)]) / friction
    return np.asarray(nnls(columns.T, (friction - unloaded) / friction)[0])


@pytest.mark.parametrize("name", sorted(BAM_LOAD))
def test_friction_by_load_is_bam_s(name: str) -> None:
    """Driving, friction without load and its growth solve BAM's own equations; driven, they are their least squares."""
    for element, model in zip(BY_LOAD, BAM_LOAD[name], strict=True):
        one = FrictionFile.read(config_path(f"friction/{name}.yaml")).elements[element]
        load: Any = one.load
        slow, fast = 1e-7 * one.omega_s, 40.0 * one.omega_s  # the Stribeck part whole, and gone
        for torque in (0.0, 5.0, 20.0):
            found = one.tau_s.positive + (load.driving + load.stribeck_driving) * torque
            found += load.quadratic_driving * torque**2
            assert found == pytest.approx(bam_friction(model, torque, slow, driving=True), rel=2 * SIX_DIGITS)
            found = one.tau_c.positive + load.driving * torque + one.c2 * fast
            assert found == pytest.approx(bam_friction(model, torque, fast, driving=True), rel=2 * SIX_DIGITS)
        assert (load.driven, load.stribeck_driven, load.quadratic_driven) == pytest.approx(
            fitted_driven(model), rel=2 * SIX_DIGITS
        )
        assert one.tau_c.negative == one.tau_c.positive
        if element != "m3":
            assert (one.omega_s, one.delta) == pytest.approx(model[-2:], rel=SIX_DIGITS)


def far_from_reversals(k: float, f_v: float, f_o: float, f_c: float, alpha: float, nu: float) -> Sliding:
    """Return what the sigmoid comes to at 1e4 rad/s either way, its exponential in a form that does not overflow."""
    sizes = []
    for v in (1e4, -1e4):
        sigmoid = 0.5 * (1.0 + math.tanh(0.5 * alpha * (v + nu)))
        sizes.append(k * abs(f_o + f_c * sigmoid))
    return Sliding((sizes[0], sizes[1]), k * f_v)


def published() -> Mapping[str, Mapping[str, Sliding]]:
    inner = [Sliding((abs(i) * r0, abs(i) * r0), i**2 * r1, abs(i) * r0) for i, r0, r1 in R3_INNER]
    outer = [Sliding((r0, r0), r1, peak * r0) for r0, r1, peak in R3_OUTER]
    bam = {
        file: {name: Sliding((kc, kc), kv, kc + sum(rest[:1]), *rest[1:]) for name, (kc, kv, *rest) in models.items()}
        for file, models in BAM.items()
    }
    return {
        "puma560": {f"joint_{k}": Sliding((g * up, g * down), g**2 * b) for k, (g, up, down, b) in enumerate(PUMA, 1)},
        "manutec_r3": {f"joint_{k}": one for k, one in enumerate((*inner, *outer), 1)},
        "ur10e": {name: Sliding((fc, fc), fv) for name, (fv, fc) in zip(UR_JOINTS, UR10E, strict=True)},
        "ur10": {name: far_from_reversals(*one) for name, one in zip(UR_JOINTS, UR10, strict=True)},
        **bam,
    }


@pytest.mark.parametrize("name", sorted(path.stem for path in config_path("friction").glob("*.yaml")))
def test_numbers_are_the_sources_converted_and_bristles_are_called_assumed(name: str) -> None:
    """Each torque is the source's, at the joint; bristles, passive, follow from static torque by a deflection."""
    file = FrictionFile.read(config_path(f"friction/{name}.yaml"))
    expected = published()[name]
    assert [element for element in file.elements.entries if element not in BY_LOAD] == list(expected)
    for element, given in expected.items():
        one = file.elements[element]
        assert (one.tau_c.positive, one.tau_c.negative) == pytest.approx(given.coulomb, rel=SIX_DIGITS)
        assert one.c2 == pytest.approx(given.viscous, rel=SIX_DIGITS)
        static = given.coulomb if given.static is None else (given.static, given.static)
        assert (one.tau_s.positive, one.tau_s.negative) == pytest.approx(static, rel=SIX_DIGITS)
        if given.omega_s is not None:
            assert (one.omega_s, one.delta) == pytest.approx((given.omega_s, given.delta), rel=SIX_DIGITS)
        assert one.alpha == 1.0
    said = file.elements
    assert file.provenance == "assumed"
    assert not {"c0", "c1", "omega_d"} & set(said.provenance)
    assert {"tau_c", "c2"} <= set(said.provenance)
    for k, one in enumerate(file.elements.entries.values()):
        deflection = 0.25e-3 if k < 3 or "erob80" in name else 0.4e-3
        c0 = max(one.tau_s.positive, one.tau_s.negative) / deflection
        assert one.c0 == pytest.approx(c0, rel=0.05)  # two digits
        assert one.c1 == pytest.approx(1e-3 * one.c0)
        assert math.isinf(one.passivity_limit(100.0))


def test_the_rig_takes_a_line_of_a_friction_file(tmp_path: Path) -> None:
    """An element as it stands in a friction file, sources and all, is the joint of a rig that is emulated."""
    published = config_path("friction/manutec_r3.yaml")
    content = read_yaml(config_path("rig/gm8224_lugre.yaml"))
    content["emulation"]["joint_friction"]["lugre"] = read_yaml(published)["elements"]["joint_1"]
    path = tmp_path / "rig.yaml"
    path.write_text(yaml_text(content), encoding="utf-8")
    assert load_rig(path).emulation.joint == FrictionFile.read(published).elements["joint_1"]


MEASURED = Path(__file__).parents[3] / "docs" / "explanation" / "measured.md"
LIBRARY = sorted(config_path("friction/library").glob("*.yaml"))
OTHERS = {
    "tx40_gautier": {
        "joint_1": (7.14, 8.05), "joint_2": (8.26, 5.53), "joint_3": (6.34, 1.97), "joint_4": (2.48, 1.11),
        "joint_5": (3.03, 1.24), "joint_6": (0.28, 0.034), "joint_5_6": (1.95, 0.616),
    },
    "panda_gaz": {
        f"panda_joint{k}": pair
        for k, pair in enumerate(
            ((0.29, 0.03), (0.20, 0.07), (0.25, 0.01), (0.50, 0.09), (0.26, 0.07), (0.160, 0.002), (0.246, 0.033)), 1
        )
    },
    "tiago_figaroh": {
        f"arm_{k}_joint": pair for k, pair in enumerate(((1.81, 30.5), (5.21, 12.8), (3.06, 4.4), (2.14, 3.99)), 1)
    },
    "ur10e_mamedov": dict(zip(
        UR_JOINTS, ((12.55, 21.26), (13.27, 20.22), (4.99, 10.38), (2.0, 3.58), (2.69, 2.49), (2.3, 3.03)), strict=True
    )),
    "direct_drive_chavez": {"shoulder": (11.7, 3.05), "elbow": (1.83, 0.125)},
}  # fmt: skip
WITHIN = {("tx40_gautier", "joint_6"): 0.35} | {("panda_gaz", f"panda_joint{k}"): 0.25 for k in (1, 2, 3)}
"""Relative difference of torques, 0.15 of all others; these elements have hardly any friction beside other torques."""


@pytest.fixture(params=LIBRARY, ids=lambda path: path.stem)
def file(request: pytest.FixtureRequest) -> FrictionFile:
    return FrictionFile.read(request.param)


def stated(file: FrictionFile, *keys: str) -> dict[str, Any]:
    found: Any = file.identification
    for key in keys:
        found = found[key]
    assert isinstance(found, dict)
    return found


def test_a_file_says_where_its_data_are_and_how_to_come_to_it(file: FrictionFile) -> None:
    """Address, revision, licence and bags' digests are there; the commands are those of the page."""
    recording, page = stated(file, "recording"), MEASURED.read_text(encoding="utf-8")
    assert file.provenance == "identified"
    assert set(recording) == {
        "arm", "source", "url", "revision", "folder", "licence", "torques", "torque_error", "described_in", "commands",
    }  # fmt: skip
    assert re.fullmatch(r"https://github\.com/[\w-]+/[\w-]+", str(recording["url"]))
    assert re.fullmatch(r"[0-9a-f]{40}", str(recording["revision"]))
    assert f"git clone {recording['url']}\n" in page
    for line in str(recording["commands"]).splitlines():
        assert line in page
    name, _, anchor = str(recording["described_in"]).partition("#")
    assert MEASURED.as_posix().endswith(name)
    headings = [re.sub(r"[^\w -]", "", one).lower().replace(" ", "-") for one in re.findall(r"^## (.*)$", page, re.M)]
    assert anchor in headings
    for bag in stated(file, "bags").values():
        assert re.fullmatch(r"[0-9a-f]{64}", bag["sha256"])


def test_identified_values_stand_in_their_intervals(file: FrictionFile) -> None:
    """Each identified value is the middle of its interval of 1.96 deviations; every element has some, and a range."""
    assert set(stated(file, "speeds")) == set(file.elements.entries) == set(stated(file, "parameters"))
    for name, element in file.elements.entries.items():
        low, high = stated(file, "speeds")[name]
        assert 0.0 < low < high < 20.0
        known = {key: one for key, one in stated(file, "parameters", name).items() if one["provenance"] == "identified"}
        assert {"tau_c_positive", "tau_c_negative"} <= set(known)
        for key, one in known.items():
            value, (least, most) = element.parameters[key], one["interval"]
            assert value == one["value"]
            digits = 1e-5 * max(abs(least), abs(most))
            assert 0.5 * (least + most) == pytest.approx(value, abs=digits)
            assert 0.5 * (most - least) == pytest.approx(1.96 * one["deviation"], abs=digits + 2e-5 * one["deviation"])


@pytest.mark.parametrize("path", LIBRARY, ids=lambda path: path.stem)
def test_torques_are_near_those_of_others(path: Path) -> None:
    """From a fifth of the fastest speed of the data on the mean torque of both directions is that of others' fits."""
    file = FrictionFile.read(path)
    others = OTHERS[path.stem]
    assert set(others) == set(file.elements.entries)
    for name, (coulomb, viscous) in others.items():
        _, high = stated(file, "speeds")[name]
        speed, element = np.linspace(0.2 * high, high, 9), file.elements[name]
        torque = 0.5 * (element.steady_torque(speed) - element.steady_torque(-speed))
        difference = float(np.abs(torque / (coulomb + viscous * speed) - 1.0).max())
        assert difference < WITHIN.get((path.stem, name), 0.15), (name, difference)
