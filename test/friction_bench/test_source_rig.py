"""The source's experiment on an emulated rig as it was: `rx90 rig source` and `config/rig/source.yaml`."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from report_pages import leave_plots_out
from rig_bench import rig_file_with
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq
from shared_files import made_once

from friction_bench.experiment.four_way import STICTION
from friction_bench.experiment.job import run_ramp
from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig, NativeBoard, VirtualPort, native_library
from friction_bench.rig.rig_file import load_rig
from rx90_common.bags.reading import read_joint_states
from rx90_common.base.share import SOURCE_RIG, config_path
from rx90_emulator.cli.frame import run

PUBLISHED = {"no-load": (949.5407, 227.8898, 0.1464), "loaded": (981.3603, 412.1713, 0.2310)}
"""The source's a and b, read in degrees, and f_c in Nm."""
SPREADS = {"ramp_error: 0.02 ": "ramp_error: 0.0 ", "gain_error: 0.003": "gain_error: 0.0", "joint_spread: 0.05": ""}


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of one measurement; its exit code 1 says that a joint's viscous friction below 0 is none."""

    def make(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            leave_plots_out(patch)
            assert run("rx90 rig source", ["--output", str(folder / "out")]) == 1

    return made_once(tmp_path_factory, "source", make) / "out"


def by_source(out: Path) -> Any:
    return yaml.safe_load((out / "estimates.yaml").read_text())["as_source"]


def test_published_friction_lies_within_the_spread_of_the_ramps(measured: Path) -> None:
    """0.1464, 0.2310 and 0.0846 Nm lie within three standard errors of the means, gain of the rig included."""
    found = by_source(measured)
    errors = {}
    for load, (_, _, coulomb) in PUBLISHED.items():
        one = found[load]
        errors[load] = math.hypot(one["spread"] / math.sqrt(one["ramps"]), 0.003 * coulomb)
        assert one["coulomb"] == pytest.approx(coulomb, abs=3 * errors[load])
        assert 0.005 < one["spread"] / one["coulomb"] < 0.1  # ramps differ, by less than the source's largest band
    joint = found["loaded"]["coulomb"] - found["no-load"]["coulomb"]
    assert joint == pytest.approx(0.0846, abs=3 * math.hypot(*errors.values()))


def test_models_differ_by_creep_and_the_experiment_by_its_spread(measured: Path) -> None:
    """Experiment and models stay within 7 % and 10 %; models differ by creep, and sliding by the rig's spread."""
    pairs = yaml.safe_load((measured / "estimates.yaml").read_text())["comparison"]
    found = {(pair["first"], pair["second"]): pair for pair in pairs}
    assert 0.1 < found["experiment", "block diagram"]["sliding"] <= found["experiment", "block diagram"]["worst"]
    assert found["experiment", "block diagram"]["worst"] < 10.0
    assert found["experiment", "multibody"]["worst"] < 7.0
    a, b, coulomb = (math.radians(PUBLISHED["loaded"][0]), math.radians(PUBLISHED["loaded"][1]), PUBLISHED["loaded"][2])
    viscous, end, joint = 0.55 / a, 3.0 * a - b, coulomb - PUBLISHED["no-load"][2]
    smooth = CubicHermiteSpline([-STICTION, STICTION], [-coulomb, coulomb], [0.0, 0.0])
    creep = 31.0 * brentq(lambda slip: coulomb - viscous * 31.0 * slip - float(smooth(slip)), 0.0, STICTION)
    assert found["multibody", "closed form"]["worst"] == pytest.approx(100 * creep / end, rel=0.1)
    release = 3 * math.hypot(0.02 * coulomb, 0.05 * joint)
    models = found["block diagram", "multibody"]
    assert models["sliding"] < 100 * release / viscous / end
    assert models["within"] is (models["worst"] <= 2.0)


def test_without_spread_the_source_states_its_own_figures(tmp_path: Path, check_report: Callable[[Path], None]) -> None:
    """Where ramps do not differ, a and b are the published ones, and 0.231 - 0.147 = 0.084 Nm to a unit at the end."""
    out, file = tmp_path / "out", rig_file_with(tmp_path, SOURCE_RIG, SPREADS)
    assert run("rx90 rig source", ["--repeats", "4", "--rig", str(file), "--output", str(out)]) == 1
    found = by_source(out)
    for load, (a, b, coulomb) in PUBLISHED.items():
        assert (found[load]["a"], found[load]["b"]) == pytest.approx((a, b), rel=0.01)
        assert found[load]["coulomb"] == pytest.approx(coulomb, rel=0.005)
    totals = found["no-load"]["total"], found["loaded"]["total"], found["f_joint"]
    assert totals == pytest.approx((0.147, 0.231, 0.084), abs=0.0011)
    assert found["f_joint"] == pytest.approx(totals[1] - totals[0])
    check_report(out / "report.html")
    page = (out / "report.html").read_text()
    for text in ("no-load, as published", "loaded, 4 ramps", "949.5", "0.084", "Not physical"):
        assert text in page


def test_velocity_is_constant_at_the_largest_torque(measured: Path) -> None:
    """The firmware holds the end torque, far above 0.18 Nm, for 1 s, in which the velocity no longer rises."""
    commands = read_joint_states(measured / "bag", "friction_bench/joint_commands")
    states = read_joint_states(measured / "bag", "friction_bench/joint_states")
    torque, velocity = commands.effort[:, 0], states.velocity[:, 0]
    assert torque.max() == pytest.approx(1.83, abs=0.004)
    first = np.flatnonzero(torque == torque.max())[:50]
    assert np.ptp(first) == 49  # one ramp's hold, without a gap
    held, rising = velocity[first[5:]], velocity[first[0] - 45 : first[0]]
    fits = [abs(float(np.polyfit(np.arange(45), part, 1)[0])) / 0.02 for part in (held, rising)]
    assert fits[0] < 0.05 * fits[1]
    assert fits[1] == pytest.approx(math.radians(PUBLISHED["no-load"][0]), rel=0.1)


class CountingBoard(NativeBoard):
    times = 0

    def switched_on(self) -> bool:
        came = super().switched_on()
        self.times += came
        return came


def test_stage_goes_off_for_a_moment_in_each_tick_of_a_ramp() -> None:
    """20 ms on and 1 us off: the stage comes on at arming and at every tick of ramp and hold."""
    rig = load_rig(config_path(SOURCE_RIG))
    board = CountingBoard(rig.baud, native_library(rig.firmware_figures))
    emulated = EmulatedRig(rig, 0, board)
    client = RigClient(VirtualPort(emulated), rig)
    client.connect()
    heard: list[Any] = []
    record = run_ramp(client, 0.61, 0.61, False, "ramp", heard.append)
    assert record.torque.max() < 0.61 + 0.008
    ticks = sum(sample.report.dac > 0 for sample in heard)
    assert ticks == pytest.approx((1.0 + 1.0) / 0.02, abs=3)  # ramp and hold
    assert board.times == pytest.approx(ticks + 1, abs=3)
