"""What the report and the terminal say: numbers with the digits they deserve, curves, bags, assumptions."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.estimates import SLIDING, ParameterEstimate
from rx90_emulator.identification.sliding import solver
from rx90_emulator.identification.sliding.fit import identify_sliding


@pytest.mark.parametrize(
    ("value", "deviation", "text"),
    [
        (100021.3, 26.4, ("100021", "26")),
        (110214.0, 203.0, ("110210", "200")),
        (28.0312, 0.0998, ("28.031", "0.100")),
        (0.04911, 0.00044, ("0.04911", "0.00044")),
        (1e-9, 1e-11, ("1e-09", "1e-11")),
        (5.0, 0.0, ("5", "0")),
    ],
)
def test_a_value_has_the_digits_of_its_deviation(value: float, deviation: float, text: tuple[str, str]) -> None:
    """A value is written to the second digit of its standard deviation."""
    assert ParameterEstimate(value, deviation).texts() == text


def test_the_drawn_curve_is_the_identified_one(sweeps: object, arm: RigidArm) -> None:
    """The line covers the measured speeds, none in between, and has the deviation that the parameters make."""
    record, _ = sweeps([2], 3)  # type: ignore[operator]
    fit = identify_sliding([record], arm)
    curve, found = fit.curves[2], fit.estimates[2]
    velocity, torque, deviation = curve.line
    assert np.abs(velocity).min() == pytest.approx(np.abs(curve.velocity).min())
    assert np.abs(velocity).max() == pytest.approx(np.abs(curve.velocity).max())
    values = np.array([found.parameters[name].value for name in SLIDING])
    deviations = np.array([found.parameters[name].deviation for name in SLIDING])

    def curve_of(p: np.ndarray[tuple[int], np.dtype[np.float64]]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        internal = np.array([p[0], p[1], p[2] - p[0], p[3] - p[1], p[6], np.log(p[4]), np.log(p[5]), 0.0])
        return solver.torque(velocity, internal)

    assert np.allclose(torque, curve_of(values))
    slope = np.array([(curve_of(values + step) - curve_of(values - step)) / (2e-5 * size)
                      for size, step in zip(values, 1e-5 * np.diag(values), strict=True)])  # fmt: skip
    covariance = np.outer(deviations, deviations) * found.correlation
    assert np.allclose(deviation, np.sqrt(np.einsum("ik,ij,jk->k", slope, covariance, slope)), rtol=1e-3)


def test_the_report_names_bags_and_assumptions(identified: tuple[Path, str]) -> None:
    """Every bag stands in the report with its use and digest, and every assumed value is marked as one, or its row."""
    output, _ = identified
    page = output.with_suffix(".html").read_text(encoding="utf-8")
    identification = yaml.safe_load(output.read_text(encoding="utf-8"))["identification"]
    for bag in identification["bags"].values():
        assert f"<td>{bag['path']}</td>" in page
        assert bag["sha256"] in page
    assert [page.count(f"<td>{use}</td>") for use in ("sliding", "presliding", "validation")] == [1, 1, 1]
    parameters = {
        name: {key: entry for key, entry in element.items() if key != "alpha" or "<th>alpha<br>" in page}
        for name, element in identification["parameters"].items()
    }
    told = {
        name: [entry["provenance"] == "assumed" for entry in element.values()]
        for name, element in parameters.items()
        if any(entry["provenance"] == "identified" for entry in element.values())
    }
    assert len(re.findall(r'<br><span class="assumed">assumed', page)) == sum(map(sum, told.values()))
    others = ", ".join(name for name in parameters if name not in told)
    assert others
    assert page.count(f"{others}: nothing identified") == 1
    assert "omega_d, at which c1 fades" in page
