"""Physically consistent inertias, held against point masses, NumPy, Pinocchio's regressor and a solver of SciPy."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from excitation_arms import plain_arm, rigid_arm, runs_of, truth
from foreign_arms import urdf_text
from scipy.linalg import qr
from scipy.optimize import least_squares

from benchmarks.excitation_runs import NOTHING, Disturbances, FourierMotion, measured
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.bodies import (
    FAR,
    BaseEstimate,
    ConsistentInertias,
    InertialPrior,
    body_of,
    consistent_inertias,
    inertial_parameters,
)
from rx90_emulator.identification.fitted import simplest_fit
from rx90_emulator.identification.rows.excitation import ExcitationProblem
from rx90_emulator.identification.rows.filtering import Bandwidths, filter_record

pytestmark = pytest.mark.slow

RNG = np.random.default_rng(11)
JOINTS = ["a", "b", "c"]
URDF = urdf_text(JOINTS, ["0 0 1", "0 1 0", "0 1 0"], [4.0, 3.0, 2.0])
ROTORS = np.array([0.3, 0.2, 0.1])


@dataclass(frozen=True, eq=False)
class Arm:
    """Three joints with rotors; everything from Pinocchio's regressor."""

    matrix: Array  # torque columns of 30 inertial parameters and 3 rotors at 40 random motions, (120, 33)
    mapping: Array  # to base parameters by a pivoted QR decomposition, (p, 33)
    truth: Array  # parameters that bodies have, other than the URDF's, (33,)

    def estimate(self, value: Array, deviation: float) -> BaseEstimate:
        base = self.matrix @ np.linalg.pinv(self.mapping)
        return BaseEstimate(self.mapping, value, base / deviation, np.ones(len(value), dtype=np.bool_))


def cloud(mass: float, place: Array, size: float) -> tuple[Array, Array]:
    """Return six point masses: masses, shape (6,), and places, shape (6, 3)."""
    share = RNG.uniform(0.5, 1.5, 6)
    return mass * share / share.sum(), place + size * RNG.standard_normal((6, 3))


def parameters_of(masses: Array, places: Array) -> Array:
    """Return the ten parameters of point masses about the origin, by sums over them."""
    inertia = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, places, strict=True))
    xx, xy, xz, yy, yz, zz = np.asarray(inertia)[np.triu_indices(3)]
    return np.array([masses.sum(), *(masses @ places), xx, xy, yy, xz, yz, zz])


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Arm:
    file = tmp_path_factory.mktemp("arm") / "arm.urdf"
    file.write_text(URDF)
    q, v, a = RNG.uniform(-2.0, 2.0, (3, 40, 3))
    links = RigidArm.from_urdf(file).regressor(q, v, a).reshape(120, 30)
    matrix = np.hstack([links, (a[:, :, None] * np.eye(3)).reshape(120, 3)])
    _, r, order = qr(matrix, mode="economic", pivoting=True)
    rank = int((np.abs(np.diag(r)) > 1e-9 * abs(r[0, 0])).sum())
    mapping = np.zeros((rank, 33))
    mapping[:, order] = np.linalg.solve(r[:rank, :rank], r[:rank])
    links = [parameters_of(*cloud(m, np.array([0.0, 0.05, 0.15]), 0.08)) for m in (5.0, 4.0, 1.5)]
    return Arm(matrix, mapping, np.concatenate([*links, 1.4 * ROTORS]))


def assert_bodies(result: ConsistentInertias) -> None:
    for pseudo in result.pseudo:
        assert np.linalg.eigvalsh(pseudo)[0] > 0.0
        moments = np.linalg.eigvalsh(body_of(pseudo).inertia)
        assert moments[0] > 0.0
        assert moments[0] + moments[1] > moments[2]
    assert (result.rotors > 0.0).all()


def test_consistent_truth_is_reproduced(arm: Arm) -> None:
    """Base parameters of an arm that can exist come back to 1e-9, from a prior that is far off."""
    prior = InertialPrior.of_urdf(URDF, JOINTS, ROTORS)
    result = consistent_inertias(arm.estimate(arm.mapping @ arm.truth, 1e-9), prior)
    np.testing.assert_allclose(arm.matrix @ result.parameters, arm.matrix @ arm.truth, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(result.base, arm.mapping @ arm.truth, rtol=1e-9, atol=1e-9)
    assert_bodies(result)


def nearest(arm: Arm, estimate: BaseEstimate) -> float:
    """Return the least squared distance that consistent inertias have, by SciPy on log-Cholesky factors."""
    white = estimate.information
    rows, columns = np.tril_indices(4)

    def parameters(x: Array) -> Array:
        factors = np.zeros((3, 4, 4))
        factors[:, rows, columns] = x[:30].reshape(3, 10)
        factors[:, range(4), range(4)] = np.exp(factors[:, range(4), range(4)])
        links = inertial_parameters(factors @ factors.transpose(0, 2, 1))
        return np.concatenate([links.ravel(), np.exp(x[30:])])

    start = np.concatenate([np.tile(np.where(rows == columns, -1.5, 0.0), 3), np.log(ROTORS)])
    found = least_squares(lambda x: white @ (arm.mapping @ parameters(x) - estimate.value), start, max_nfev=400)
    return float(2.0 * found.cost)


@pytest.mark.parametrize("spoiled", ["rotor", "moment"])
def test_inconsistent_estimate_changes_least(arm: Arm, spoiled: str) -> None:
    """Where no body has the estimate, all bodies exist in the end, near what SciPy finds without a prior."""
    theta = arm.truth.copy()
    if spoiled == "rotor":
        theta[32] = -0.05
    else:
        theta[24:30] = [0.3, 0.0, 0.05, 0.0, 0.0, 0.05]  # Ixx > Iyy + Izz
    estimate = arm.estimate(arm.mapping @ theta, 0.05)
    result = consistent_inertias(estimate, InertialPrior.of_urdf(URDF, JOINTS, ROTORS), weight=0.01)
    assert_bodies(result)
    least = nearest(arm, estimate) / len(estimate.value)
    assert least > 1.0
    assert least - 1e-6 <= result.distance**2 <= 1.4 * least + 1e-3
    covariance = np.linalg.inv(estimate.information.T @ estimate.information)
    squares = result.shift @ np.linalg.solve(covariance, result.shift)
    assert np.sqrt(squares / len(estimate.value)) == pytest.approx(result.distance)


def test_what_the_data_do_not_determine_counts_for_nothing(arm: Arm) -> None:
    """A parameter without information does not matter, whatever its value; springs and offsets may be anything."""
    mapping = np.zeros((len(arm.mapping) + 1, 34))
    mapping[:-1, :33], mapping[-1, 33] = arm.mapping, 1.0
    known, count = np.arange(len(mapping)) != 2, len(arm.mapping)
    base = arm.matrix @ np.linalg.pinv(arm.mapping)
    information = np.zeros((len(base) + 1, count + 1))
    information[:-1, :-1], information[-1, -1] = base / 1e-4, 1e3
    information[:, 2] = 0.0
    results = []
    for nonsense in (-1e6, 1e3):
        value = mapping @ np.append(arm.truth, -33.0)
        value[2] = nonsense
        estimate = BaseEstimate(mapping, value, information, known)
        results.append(consistent_inertias(estimate, InertialPrior.of_urdf(URDF, JOINTS, ROTORS)))
    np.testing.assert_array_equal(results[0].parameters, results[1].parameters)
    added = information @ (results[1].base - mapping @ np.append(arm.truth, -33.0))
    assert np.linalg.norm(added) < 1e-2 * np.linalg.norm(information[:, known] @ value[known])
    assert results[1].parameters[33] == pytest.approx(-33.0, abs=1e-3)
    assert_bodies(results[1])


def with_fixed(name: str, mass: float, inertia: float, urdf: str = URDF) -> str:
    moments = f'ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"'
    link = f'<link name="{name}"><inertial><mass value="{mass}"/><inertia {moments}/></inertial></link>'
    joint = f'<joint name="to_{name}" type="fixed"><origin xyz="0 0 0.3"/><parent link="c_link"/><child link="{name}"/>'
    return urdf.replace("</robot>", f"{link}{joint}</joint></robot>")


def test_prior_decides_what_the_data_leave_open(arm: Arm) -> None:
    """With data of next to no weight the result is the prior; with a known tool its share stays, whatever the data."""
    urdf = with_fixed("tool", 2.0, 0.1)
    prior = InertialPrior.of_urdf(urdf, JOINTS, ROTORS, known=["tool"])
    np.testing.assert_allclose(prior.known[2], [2.0, 0, 0, 0.6, 0.28, 0, 0.28, 0, 0, 0.1], atol=1e-15)
    result = consistent_inertias(arm.estimate(arm.mapping @ arm.truth, 1e4), prior)
    for pseudo, body in zip(result.pseudo, prior.bodies, strict=True):
        np.testing.assert_allclose(pseudo, body.pseudo, rtol=1e-3, atol=1e-4)
    strong = consistent_inertias(arm.estimate(arm.mapping @ arm.truth, 1e-3), prior)
    np.testing.assert_allclose(
        strong.parameters[20:30] - inertial_parameters(strong.pseudo[2]), prior.known[2], atol=1e-14
    )
    assert_bodies(strong)
    with_both = with_fixed("flange", 2.0, 0.1, urdf)
    two = InertialPrior.of_urdf(with_both, JOINTS, ROTORS, known=["tool", "flange"])
    np.testing.assert_allclose(two.known[2], 2.0 * prior.known[2])
    both = InertialPrior.of_urdf(urdf, JOINTS, ROTORS)
    assert [body.link for body in both.bodies] == ["a_link", "b_link", "c_link", "tool"]
    shared = consistent_inertias(arm.estimate(arm.mapping @ arm.truth, 1e-6), both)
    assert_bodies(shared)
    np.testing.assert_allclose(arm.matrix @ shared.parameters, arm.matrix @ arm.truth, atol=1e-5)


def test_bodies_predict_unseen_runs_better_than_least_squares(tmp_path: Path) -> None:
    """Of arms with ripple and load, described wrong by factors of 1.6, the bodies' torque on another run is nearer."""
    identified, bodies = [], []
    for seed in (0, 4, 8, 13):
        arm = plain_arm(seed, 3 + seed % 4, coupled=False)
        rigid = rigid_arm(arm, tmp_path)
        seen, unseen = (
            ExcitationProblem.of(rigid, runs_of(arm, 500.0, worse, seeds=(k,), periods=1))
            for k, worse in ((0, Disturbances(coloured=0.05, ripple=0.05, load=0.2)), (7, Disturbances()))
        )
        fitted = simplest_fit(seen)
        estimate = BaseEstimate.of(seen, fitted)
        prior = InertialPrior.of_urdf(arm.urdf(0.5), arm.names, arm.rotor, arm.spring[arm.spring != 0.0])
        base = consistent_inertias(estimate, prior).base
        true, size = truth(seen, arm)[0], np.linalg.norm(unseen.torque)
        for found, value in ((identified, fitted.fit.linear), (bodies, base)):
            found.append(float(np.linalg.norm(unseen.regressor @ (value - true)) / size))
    assert np.mean(bodies) < 0.9 * np.mean(identified)


def test_few_instants_of_seven_joints_tell_plausible_bodies(tmp_path: Path) -> None:
    """With fewer instants than the covariance has rows the bodies predict as the base parameters do, or better."""
    arm, names = plain_arm(1, 7, coupled=False), [f"joint_{k}" for k in range(1, 8)]
    urdf = re.sub(r"<inertial>.*?</inertial>", "", arm.urdf(), flags=re.DOTALL)
    (tmp_path / "arm.urdf").write_text(urdf, encoding="utf-8")
    rigid = RigidArm.from_urdf(tmp_path / "arm.urdf", spring=arm.spring, massless=True)
    problems = []
    for seed, noise in ((0, Disturbances(corner=1.0)), (7, NOTHING)):
        motion = FourierMotion.random(arm, seed, harmonics=4, period=18.0, periods=1, speed=(0.3, 0.7))
        record = measured(arm, motion, 100.0, seed, noise).record(arm)
        problems.append(ExcitationProblem.of(rigid, filter_record(record, Bandwidths(6.0, 2.0))))
    seen, unseen = problems
    prior = InertialPrior.of_urdf(urdf, names, np.zeros(7), arm.spring[arm.spring != 0.0])
    fit = simplest_fit(seen)
    found = consistent_inertias(BaseEstimate.of(seen, fit), prior)
    left = unseen.torque - fit.predicted(unseen)
    errors = [np.linalg.norm(left), np.linalg.norm(left - unseen.regressor @ found.shift)]
    assert errors[1] < 1.1 * errors[0]
    assert_bodies(found)
    masses = found.pseudo[:, 3, 3]
    true = np.array([link.mass for link in arm.links])
    assert (masses < 10.0 * true).all()
    assert masses.sum() < 3.0 * true.sum()


def test_bodies_far_from_the_base_parameters_are_warned_of(arm: Arm) -> None:
    """A tool that is known wrong keeps the bodies far away: the warning has the number; near ones have no warning."""
    estimate = arm.estimate(arm.mapping @ arm.truth, 0.5)
    for urdf, known, far in ((URDF, (), False), (with_fixed("tool", 90.0, 4.0), ("tool",), True)):
        inertias = consistent_inertias(estimate, InertialPrior.of_urdf(urdf, JOINTS, ROTORS, known=known))
        said = inertias._replace(shares=(0.01, 0.04))
        assert (inertias.distance > FAR) == far == bool(said.warning)
        assert f"{inertias.distance:.2g} standard deviations" in said.text
        added = np.linalg.norm(arm.matrix @ (inertias.parameters - arm.truth)) / 0.5
        assert inertias.distance == pytest.approx(added / np.sqrt(len(estimate.value)))
        if far:
            assert f"{inertias.distance:.3g} standard deviations" in said.warning
            assert "torque RMS 4.0% in place of 1.0%" in said.warning


def test_a_mass_that_no_torque_depends_on_stays(arm: Arm) -> None:
    """Of a first link on a vertical axis no torque tells the mass: it stays near the description's."""
    inertias = consistent_inertias(
        arm.estimate(arm.mapping @ arm.truth, 1e-2), InertialPrior.of_urdf(URDF, JOINTS, ROTORS)
    )
    assert inertias.pseudo[0, 3, 3] == pytest.approx(4.0, rel=0.3)


def test_a_model_without_rotors_has_none(tmp_path: Path) -> None:
    """Where torques hold no rotors, no base parameter does, and links alone explain torques that rotors would not."""
    arm = replace(plain_arm(2, 3, coupled=False), rotor=np.zeros(3))
    rigid = rigid_arm(arm, tmp_path)
    runs = runs_of(arm, 200.0, NOTHING, periods=1)
    without = ExcitationProblem.of(rigid, runs, rotors=False)
    assert not any("Ia" in group for group in without.base.groups)
    assert any("Ia" in group for group in ExcitationProblem.of(rigid, runs).base.groups)
    fitted = simplest_fit(without)
    assert np.linalg.norm(fitted.fit.residual) < 5e-3 * np.linalg.norm(without.torque)
    estimate = BaseEstimate.of(without, fitted)
    prior = InertialPrior.of_urdf(arm.urdf(0.5), arm.names, None, arm.spring[arm.spring != 0.0])
    found = consistent_inertias(estimate, prior)
    assert not found.rotors.any()
    assert all(np.linalg.eigvalsh(pseudo)[0] > 0.0 for pseudo in found.pseudo)


BARE = URDF.replace(URDF[URDF.index("<inertial>") : URDF.index("</inertial>") + len("</inertial>")], "", 1)
SAME = urdf_text(JOINTS, ["0 0 1", "0 1 0", "0 1 0"], [1.0, 1.0, 1.0])
FLAT = URDF.replace('iyy="0.08"', 'iyy="0.9"')


@pytest.mark.parametrize(
    ("urdf", "words"),
    [(BARE, ["a_link at a: <inertial> is missing or none that a body can have"]),
     (FLAT, ["a_link at a: <inertial> is missing or none that a body can have"]),
     (SAME, [f"{name}_link at {name}: <inertial> is the same for all links" for name in JOINTS])],
    ids=["missing", "impossible", "placeholders"],
)  # fmt: skip
def test_prior_without_inertials(urdf: str, words: list[str]) -> None:
    """What the URDF lacks begins as a body along the link, and the prior says so, for unknown rotors too."""
    prior = InertialPrior.of_urdf(urdf, JOINTS, [0.0, 0.2, 0.1])
    assert [text.split(";")[0] for text in prior.replaced[:-1]] == words
    assert prior.replaced[-1].startswith("rotor of a: begins at ")
    assert all(np.linalg.eigvalsh(body.pseudo)[0] > 0.0 for body in prior.bodies)
    body = body_of(prior.bodies[0].pseudo)
    mass, center, inertia = body.mass, body.lever, body.inertia
    np.testing.assert_allclose(center, [0.0, 0.0, 0.2])  # joint b lies 0.4 m above joint a
    about = inertia + mass * (center @ center * np.eye(3) - np.outer(center, center))
    assert prior.rotors[0] == pytest.approx(np.trace(about) / 3.0)
    radius, half = 0.4 / 6.0, 0.2
    assert mass == pytest.approx(1500.0 * 4.0 / 3.0 * np.pi * radius**2 * half)
    np.testing.assert_allclose(np.diag(inertia), mass / 5.0 * np.array([half**2 + radius**2] * 2 + [2 * radius**2]))


def test_runs_that_determine_nothing_are_refused(arm: Arm) -> None:
    """Without a base parameter that the data determine there are no bodies."""
    value = arm.mapping @ arm.truth
    good = arm.estimate(value, 1.0)
    estimate = BaseEstimate(good.mapping, value, good.information, np.zeros_like(good.determined))
    with pytest.raises(IdentificationError, match=r"^.*accepted: .*$"):
        consistent_inertias(estimate, InertialPrior.of_urdf(URDF, JOINTS, ROTORS))
