"""The verdict on two bags, and its figures."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_making import NAMES, ROS1, joint_state, series, write_ros1, write_ros2
from hypothesis import given, settings
from hypothesis import strategies as st

from rx90_common.bags.comparison import Scope, TopicComparison, Verdict, compare_series
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.tolerance import Tolerances
from rx90_common.bags.writing import write_joint_states
from rx90_emulator.cli.frame import run
from rx90_emulator.loop.run_messages import trajectory_message


def compared(a: JointSeries, b: JointSeries, *rules: str, **scope: Any) -> TopicComparison:
    return compare_series(a, b, Tolerances(*rules), Scope(**scope))


def changed(source: JointSeries, row: int, column: int, value: float, field: str = "position") -> JointSeries:
    values = source.fields[field].copy()
    values[row, column] = value
    return replace(source, **{field: values})


def joined(*parts: JointSeries) -> JointSeries:
    fields = {f: np.concatenate([p.fields[f] for p in parts]) for f in parts[0].fields}
    return JointSeries(parts[0].topic, parts[0].names, np.concatenate([p.stamp_ns for p in parts]), **fields)


def value_of(result: TopicComparison, joint: str, field: str) -> Any:
    return next(v for v in result.values if (v.joint, v.field) == (joint, field))


@settings(max_examples=60)
@given(st.permutations(range(3)), st.integers(0, 19), st.integers(0, 2), st.floats(1e-12, 1e3), st.data())
def test_one_change_is_found(order: list[int], row: int, column: int, step: float, data: Any) -> None:
    """In any order of joints and messages, one changed number gives its distance, its time and its RMS."""
    field = data.draw(st.sampled_from(["position", "velocity", "effort"]))
    a = series()
    b = changed(a, row, column, a.fields[field][row, column] + step, field)
    distance = abs(b.fields[field][row, column] - a.fields[field][row, column])
    b = b.select([NAMES[i] for i in order]).take(np.array(data.draw(st.permutations(range(20)))))
    result = compared(a, b)
    found = value_of(result, NAMES[column], field)
    assert found.maximum == distance
    assert found.rms == pytest.approx(distance / math.sqrt(20))
    assert found.beyond == 1
    assert found.at_ns == a.stamp_ns[row]
    assert result.verdict is Verdict.DIFFERS
    assert all(v.maximum == 0 and not v.beyond for v in result.values if v is not found)
    assert compared(a, b, f"{field}={float(distance)!r}").verdict is Verdict.SAME
    assert compared(a, b, f"{field}={float(np.nextafter(distance, 0))!r}").verdict is Verdict.DIFFERS


@pytest.mark.parametrize(
    ("one", "other", "exact", "within_1"),
    [
        (math.nan, math.nan, "same", "same"),
        (math.nan, np.int64(0x7FF8000000000001).view(np.float64), "differs", "same"),
        (math.inf, math.inf, "same", "same"),
        (0.0, -0.0, "differs", "same"),
        (1.0, np.nextafter(1.0, 2.0), "differs", "same"),
        (math.nan, 0.0, "differs", "differs"),
        (math.inf, -math.inf, "differs", "differs"),
        (math.inf, 1.0, "differs", "differs"),
        (1.5e308, -1.5e308, "differs", "differs"),
    ],
)
def test_special_numbers(one: float, other: float, exact: str, within_1: str) -> None:
    """NaN and infinity equal only themselves, and without a tolerance every bit counts."""
    a, b = changed(series(), 3, 1, one), changed(series(), 3, 1, other)
    for x, y in ((a, b), (b, a)):
        assert compared(x, y).verdict.name.lower() == exact
        assert compared(x, y, "position=1").verdict.name.lower() == within_1
        found = value_of(compared(x, y), NAMES[1], "position")
        assert math.isfinite(found.maximum)
        assert math.isfinite(found.rms)


@pytest.mark.parametrize(
    ("align", "code", "said"),
    [
        ("start", 0, "moved by -0.500000000 s"),
        ("trajectory", 0, "moved by -0.500000000 s"),
        ("-0.5", 0, "moved by -0.500000000 s"),
        ("-0.4", 1, "moved by -0.400000000 s"),
        ("0", 2, "no stamp in common"),
    ],
)
def test_bags_of_runs_that_began_at_other_times_are_aligned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], align: str, code: int, said: str
) -> None:
    """The second bag's stamps are moved by start, by trajectory or by a time, and the text says by how much."""
    one = series(400)
    for name, shift in (("a", 0), ("b", 500_000_000)):
        content = {"joint_names": list(NAMES), "points": []}
        start = trajectory_message("/rx90_controller/trajectory_accepted", 3_000_000 + shift, content)
        write_joint_states(tmp_path / name, [replace(one, stamp_ns=one.stamp_ns + shift)], messages=[start])
    words = ["compare", str(tmp_path / "a"), str(tmp_path / "b"), f"--align={align}"]
    assert run("rx90 bag", words) == code
    out, err = capsys.readouterr()
    assert said in out + err


def test_messages_of_one_stamp_are_paired_in_their_order() -> None:
    """Two runs in one bag equal themselves; a second message with the same stamp and other content is counted."""
    a = joined(series(6), changed(series(6, seed=5), 2, 0, 7.0))
    assert compared(a, a).verdict is Verdict.SAME
    result = compared(a, joined(series(6), changed(series(6, seed=5), 2, 0, 7.5)))
    assert value_of(result, NAMES[0], "position").maximum == 0.5
    assert result.pairs == 12
    once = series(6)
    result = compared(once, joined(once, changed(once.take(slice(2, 3)), 0, 0, 99.0)))
    assert (result.verdict, result.b.missing) == (Verdict.DIFFERS, 1)


def test_what_only_one_has() -> None:
    """Joints and arrays of only one series make a difference; with nothing in common there is no verdict."""
    a = series()
    assert compared(a, a.select(NAMES[:2])).reasons == ("only the first bag has joint_3",)
    assert compared(replace(a, effort=None), a).reasons == ("only the second bag has effort",)
    assert compared(a, series(names=("x", "y", "z"))).verdict is Verdict.INCOMPARABLE
    assert compared(a, replace(a, stamp_ns=a.stamp_ns + 1)).verdict is Verdict.INCOMPARABLE


def test_the_last_tolerance_that_fits_decides() -> None:
    """Each of topic, joint and field may be any."""
    tolerances = Tolerances("position=1", "t:position=2", "*:a:position=3", "t:a:effort=4")
    assert [tolerances.of(topic, joint, "position") for topic in ("/t", "/u") for joint in "ab"] == [3, 2, 3, 1]
    assert [tolerances.of("/t", joint, "effort") for joint in "ab"] == [4, 0]


def test_exit_codes_of_a_ros1_bag_against_ros2_bags(tmp_path: Path) -> None:
    """0: the same messages, or within a tolerance; 1: others; 2: a topic too many, or joints without a match."""
    contents = [(i, ["a", "b"], [float(i), -float(i)]) for i in range(20)]
    ros1 = [("/joint_states", i, joint_state(i, n, v, store=ROS1)) for i, n, v in contents]
    ros2 = [("/joint_states", i + 5, joint_state(i, n, v)) for i, n, v in contents]
    a, b = write_ros1(tmp_path / "a.bag", ros1), write_ros2(tmp_path / "b", ros2, "sqlite3")
    assert run("rx90 bag", ["compare", str(a), str(b)]) == 0
    ros2[4] = ("/joint_states", 9, joint_state(4, ["a", "b"], [4.0, 4.5]))
    c = write_ros2(tmp_path / "c", ros2)
    assert run("rx90 bag", ["compare", str(a), str(c)]) == 1
    for rule, code in (("joint_states:a:position=8.6", 1), ("position=8.6", 0)):
        assert run("rx90 bag", ["compare", str(a), str(c), "--tolerance", rule]) == code
    more = write_ros2(tmp_path / "more", [*ros2, ("/motor_states", 1, joint_state(1, ["m"], [1.0]))])
    assert run("rx90 bag", ["compare", str(c), str(more)]) == 2
    assert run("rx90 bag", ["compare", str(c), str(more), "--topic", "joint_states"]) == 0
    ros2[4] = ("/joint_states", 9, joint_state(4, ["gripper"], [4.0]))
    d = write_ros2(tmp_path / "d", ros2)
    assert run("rx90 bag", ["compare", str(d), str(d)]) == 2


@settings(max_examples=25)
@given(*[st.lists(st.integers(0, 12), min_size=1, max_size=12)] * 2)
def test_counts_of_stamps(stamps_a: list[int], stamps_b: list[int]) -> None:
    """For any stamps, also repeated ones, pairs, missing and outside messages are those of sets of stamps."""

    def make(stamps: list[int]) -> JointSeries:
        return JointSeries("/t", ("a",), np.array(stamps), np.array(stamps, dtype=float)[:, None])

    result = compared(make(stamps_a), make(stamps_b))
    a, b = set(stamps_a), set(stamps_b)
    if not a & b:
        assert result.verdict is Verdict.INCOMPARABLE
        return
    common = set(range(max(min(a), min(b)), min(max(a), max(b)) + 1))
    assert result.pairs == len(a & b)
    assert result.a.missing == len((a - b) & common)
    assert result.b.missing == len((b - a) & common)
    assert result.a.outside == len(a - common)
    assert (result.verdict is Verdict.SAME) == (a == b)
    within = compared(make(stamps_a), make(stamps_b), common_range=True)
    assert (within.verdict is Verdict.SAME) == (a & common == b & common)


def test_empty_topics_are_no_difference(tmp_path: Path) -> None:
    """A topic without messages in either bag is passed over, unless it was asked for."""
    empty = JointSeries("/quiet", ("a",), np.zeros(0, dtype=np.int64))
    for name in "ab":
        write_joint_states(tmp_path / name, [series(), empty])
    bags = [str(tmp_path / name) for name in "ab"]
    assert run("rx90 bag", ["compare", *bags]) == 0
    assert run("rx90 bag", ["compare", *bags, "--topic", "quiet"]) == 2


def test_rms_and_maximum_of_all_rows() -> None:
    """Maximum and RMS of random differences are those of the plain formulas, of those that are finite."""
    a, b = (changed(series(500, seed=k), 7, 1, math.nan) for k in (1, 2))
    result = compared(a, b)
    for field, values in a.fields.items():
        distance = np.where(np.isnan(values), 0.0, values - b.fields[field])
        finite = np.isfinite(values).sum(axis=0)
        for column, joint in enumerate(NAMES):
            found = value_of(result, joint, field)
            assert found.maximum == np.abs(distance[:, column]).max()
            assert found.at_ns == a.stamp_ns[np.abs(distance[:, column]).argmax()]
            assert found.rms == pytest.approx(np.sqrt(np.sum(distance[:, column] ** 2) / finite[column]), rel=1e-12)
