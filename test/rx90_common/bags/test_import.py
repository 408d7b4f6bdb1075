"""Logs in columns become bags, and bags tables: units, dialects, times, damaged rows, every bit."""

import csv
from datetime import datetime, timezone
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from bag_making import joint_state, write_ros2
from processes import files_up_to
from rosbags.highlevel import AnyReader

from rx90_common.bags.exporting import export_bag
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.logs import read_log
from rx90_common.bags.mapping import LogMapping
from rx90_common.bags.plotting import plot_bags
from rx90_common.bags.reading import read_bag, read_joint_states
from rx90_common.bags.writing import write_joint_states
from rx90_common.base.errors import BagError
from rx90_emulator.cli.frame import run

TIME = np.array([0.5, 0.75, 1.25])
POSITION = np.array([[10.0, -20.0], [11.5, -21.25], [12.0, -22.0]])
PLAIN = """\
time: {column: 1, unit: s}
header: 0
names: [a, b]
position: {columns: [2, 3], unit: rad}
"""
EXPORTED = PLAIN.replace("header: 0", "header: 1")
SEMICOLON = 'delimiter: ";"\n'
COMMA = SEMICOLON + 'decimal: ","\n'
BLANKS = "delimiter: space\n"


def write(path: Path, text: str, encoding: str = "utf-8") -> Path:
    path.write_text(text, encoding=encoding)
    return path


def imported(folder: Path, mapping: str, log: str, encoding: str = "utf-8") -> JointSeries:
    chosen = LogMapping.load(write(folder / "mapping.yaml", mapping))
    (series,) = read_log(write(folder / "log.csv", log, encoding), chosen)
    return series


def rows(delimiter: str, decimal: str = ".", end: str = "") -> str:
    table = np.column_stack([TIME, POSITION])
    return "\n".join(delimiter.join(str(x).replace(".", decimal) for x in row) + end for row in table)


@pytest.mark.parametrize(
    ("text", "mapping"),
    [
        (rows(","), PLAIN.replace("header: 0\n", "")),
        (rows(";", ","), PLAIN.replace("header: 0\n", "")),
        ("the run of today\n# t a b\n" + rows(" "), PLAIN.replace("header: 0\n", "").replace("2, 3", "a, b")),
        (rows(", ", end=","), PLAIN),
        (rows(";", end=";a,b,c,1,2,3,4,d"), PLAIN + SEMICOLON),
        (rows(";", ","), PLAIN + COMMA),
        ('"t";"a";"b"\n"' + rows('";"', ",", '"').replace("\n", '\n"'), PLAIN.replace("0", "1") + COMMA),
        (" " + rows("\t    "), PLAIN + BLANKS),
        (rows("\t"), PLAIN + "delimiter: tab\n"),
        ("% of the 3rd run\n" + rows(";").replace("\n", "\r\n") + "\n\n# the end\n", PLAIN + SEMICOLON),
        ("t,a,b,tau\n" + rows(",", end=","), PLAIN.replace("0", "1")),  # a column that is empty and not used
    ],
)
def test_delimiter_decimal_sign_and_header_are_found_out_or_said(tmp_path: Path, text: str, mapping: str) -> None:
    """Commas, semicolons, tabs, blanks, decimal commas, headers and comments give the same numbers."""
    found = imported(tmp_path, mapping, text, "utf-8-sig")
    assert found.stamp_ns.tolist() == [500_000_000, 750_000_000, 1_250_000_000]
    assert found.names == ("a", "b")
    assert np.array_equal(found.position, POSITION)
    assert found.velocity is None
    assert found.effort is None


def test_texts_of_windows_are_read(tmp_path: Path) -> None:
    """UTF-16 with the mark of either order of bytes."""
    for mark in ("", "\ufeff"):
        found = imported(tmp_path, PLAIN, mark + rows(","), "utf-16-be" if mark else "utf-16")
        assert np.array_equal(found.position, POSITION)


@pytest.mark.parametrize(
    ("field", "unit", "values", "expected"),
    [
        ("position", "unit: deg", (180.0, -90.0), (np.pi, -np.pi / 2)),
        ("position", "unit: turns, factor: [1, -0.01]", (0.5, 100.0), (np.pi, -2 * np.pi)),
        ("velocity", "unit: deg/s", (360.0, 1.0), (2 * np.pi, np.pi / 180)),
        ("velocity", "unit: rpm, factor: 0.5", (60.0, 120.0), (np.pi, 2 * np.pi)),
        ("effort", "unit: Nm", (3.0, 4.0), (3.0, 4.0)),
        ("effort", "unit: mA, factor: [1, -1]", (300.0, 400.0), (0.3, -0.4)),
    ],
)
def test_units_become_si(
    tmp_path: Path, field: str, unit: str, values: tuple[float, float], expected: tuple[float, float]
) -> None:
    """Angles, turns and currents are what they are in rad, rad/s, Nm and A, times a factor of each joint."""
    mapping = f"rate: 1.5\nnames: [a, b]\n{field}: {{columns: [y, x], {unit}}}\n"
    found = imported(tmp_path, mapping, "# x,y\n" + 3 * f"{values[1]},{values[0]}\n")
    assert getattr(found, field)[1] == pytest.approx(expected, rel=1e-14)
    assert found.stamp_ns.tolist() == [0, 666_666_667, 1_333_333_333]  # the nearest ns each


@pytest.mark.parametrize(("unit", "scale"), [("s", 9), ("ms", 6), ("us", 3), ("ns", 0)])
def test_stamps_of_the_wall_clock_are_exact(tmp_path: Path, unit: str, scale: int) -> None:
    """A stamp of 19 digits keeps its last ns in every unit, which floating point does not."""
    stamps = [1_700_000_000_123_456_789, 1_700_000_000_123_456_790]
    log = "\n".join(f"{Decimal(s).scaleb(-scale)},1,2" for s in stamps)
    assert imported(tmp_path, PLAIN.replace("unit: s", f"unit: {unit}"), log).stamp_ns.tolist() == stamps


@pytest.mark.parametrize("zone", ["", "Z", "+02:00"])
@pytest.mark.parametrize(("between", "point"), [("T", "."), (" ", "."), (" ", ",")])
def test_times_of_iso_8601_are_exact(tmp_path: Path, zone: str, between: str, point: str) -> None:
    """Dates with a time of day are read to the ns, with or without a zone, also with a decimal comma; UTC without."""
    text = "\n".join(f"2024-05-01{between}12:00:0{k}{point}123456789{zone};{k};0{point}5" for k in range(3))
    hour = 12 - 2 * (zone == "+02:00")
    begin = int(datetime(2024, 5, 1, hour, tzinfo=timezone.utc).timestamp()) * 10**9 + 123_456_789
    found = imported(tmp_path, PLAIN + SEMICOLON + f'decimal: "{point}"\n', text)
    assert found.stamp_ns.tolist() == [begin + k * 10**9 for k in range(3)]
    assert np.array_equal(found.position, [[0.0, 0.5], [1.0, 0.5], [2.0, 0.5]])


HEADED = ("header: 0", "header: 1")
TWICE = (PLAIN.partition("header")[2], PLAIN.partition("header")[2].replace(": 0", ": 1").replace("2, 3", "2, qb"))


@pytest.mark.parametrize(
    ("change", "log", "said"),
    [
        (("[2, 3]", "[2]"), b"1,2,3", "position.columns is [2]; accepted: a list of 2, one for each name"),
        (("[2, 3]", "[2, qb]"), b"1,2,3", "log.csv: no column 'qb'; there are 1, 2, 3"),
        (("[2, 3]", "[2, 0]"), b"1,2,3", "position.columns[1] is 0; accepted: the number of a column, from 1 on, or"),
        (("rad", "rad, factor: [1, 0]"), b"1,2,3", "position.factor[1] is 0; accepted: a finite number other than 0"),
        (("[2, 3]", "[2, 2]"), b"1,2,3", "position.columns is [2, 2]; accepted: a list of columns, one for each name"),
        (("[a, b]", '[a, "b\\0"]'), b"1,2,3", "names is ['a', 'b\\x00']; accepted: a list of texts"),
        (HEADED, b"0,1,2\n1,2,3\n", "log.csv: no names in line 1; accepted: header, their line, or 0 for none"),
        (TWICE, b"t,qb,qb\n1,2,3", "log.csv: more than one column 'qb'; there are t, qb, qb, 1, 2, 3"),
        (HEADED, b"t,a,b\n", "log.csv: "),
        (HEADED, b"t,a,b\n0,1e999,2\n", "1 corrupt row, the first in line 2: column 2 is '1e999'; accepted: numbers"),
        (HEADED, b"t,a,b\n0,1,2\n1,2,3_0\n2,2,x\n", "2 corrupt rows, the first in line 3: column 3 is '3_0'"),
        (HEADED, b"t,a,b\n0,1,2\n1,2,\n", "line 3: column 3 is ''; accepted: numbers"),
        (HEADED, b"t,a,b\n0,1,\0\n", "line 2: column 3 is '\ufffd'; accepted: numbers"),
        (HEADED, b"t,a,b\n0,1,2\n1,2\n", "log.csv: 2 fields in line 3, others have 3; accepted: "),
        (HEADED, b't,a,b,c\n0,1,2,"x\n1,1,2,x\n', "a quotation mark without a second one in its line"),
        (HEADED, b"t,a,b\n,1,2\n", "line 2: column 1 is ''; accepted: times of 0 to 2147483648 s, or ISO 8601"),
        (HEADED, b"t,a,b\n2147483648,1,2\n", "line 2: column 1 is '2147483648'; accepted: times of 0 to 2147483648 s"),
        (HEADED, b"t,a,b\n0,1,2\n5,1,2\n5,1,2\n", "line 4: column 1 is '5'; accepted: a later time than in the row"),
    ],
)
def test_what_does_not_fit_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], log: bytes, said: str
) -> None:
    """A mapping and a log that do not fit, torn rows, no numbers, no times: one line, and nothing is made."""
    (tmp_path / "log.csv").write_bytes(log)
    write(tmp_path / "m.yaml", PLAIN.replace(*change))
    words = ["import", str(tmp_path / "log.csv"), str(tmp_path / "bag"), "--signals", str(tmp_path / "m.yaml")]
    assert run("rx90 bag", words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert sorted(file.name for file in tmp_path.iterdir()) == ["log.csv", "m.yaml"]


def test_a_table_may_hold_several_topics(tmp_path: Path) -> None:
    """Each topic has names and columns of its own, or the same with another unit; the times are common."""
    topics = "topics: {joint_states: {names: [a], position: {columns: [q], unit: deg}}, \
motor_states: {names: [m], effort: {columns: [q], unit: A}}}"
    mapping = LogMapping.load(write(tmp_path / "map.yaml", "time: {column: t, unit: ms}\n" + topics))
    joints, motors = read_log(write(tmp_path / "log.csv", "t,q\n1,180\n3,90\n"), mapping)
    assert (joints.topic, joints.names) == ("/joint_states", ("a",))
    assert (motors.topic, motors.names) == ("/motor_states", ("m",))
    assert joints.position[:, 0] == pytest.approx([np.pi, np.pi / 2])
    assert motors.effort[:, 0].tolist() == [180.0, 90.0]
    assert motors.stamp_ns.tolist() == [1_000_000, 3_000_000]


def test_an_exact_log_is_taken_as_it_stands(tmp_path: Path) -> None:
    """Also what is not finite, and times that repeat or go back, in their order."""
    series = imported(tmp_path, PLAIN + "exact: true\n", "1,nan,2\n0,inf,3\n0,4,-1e12\n")
    assert series.stamp_ns.tolist() == [0, 0, 10**9]
    assert np.array_equal(series.position, [[np.inf, 3.0], [4.0, -1e12], [np.nan, 2.0]], equal_nan=True)


def test_efforts_in_amperes_stay_amperes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Currents are called A in the bag, its table, plots, comparisons and exports, and on the way back; torques Nm."""
    for unit in ("mA", "mNm"):
        mapping = PLAIN.replace("position: {columns: [2, 3], unit: rad}", f"effort: {{columns: [2, 3], unit: {unit}}}")
        folder = tmp_path / unit
        folder.mkdir()
        imported(folder, mapping, rows(","))
        words = ["import", str(folder / "log.csv"), str(folder / "bag"), "--signals", str(folder / "mapping.yaml")]
        assert run("rx90 bag", words) == 0
        series = read_joint_states(folder / "bag", "joint_states")
        np.testing.assert_array_equal(series.effort, POSITION * 1e-3)
        label = f"effort [{unit.removeprefix('m')}]"
        assert series.quantities["effort"] == series.take(slice(0, 2)).select(["b"]).quantities["effort"] == label
        (drawn,) = plot_bags([folder / "bag"])["/joint_states"]
        assert drawn.yaxis.axis_label.text == label.replace(" [", ", ").removesuffix("]")
        tables, again = folder / "tables", folder / "again"
        export_bag(folder / "bag", tables)
        assert (tables / "joint_states.csv").read_text().splitlines()[0] == f"time [s],a {label},b {label}"
        signals = write(folder / "tables.yaml", EXPORTED.replace("position", "effort").replace("rad", label[8:-1]))
        words = ["import", str(tables / "joint_states.csv"), str(again), "--signals", str(signals)]
        assert run("rx90 bag", words) == 0
        assert run("rx90 bag", ["compare", str(folder / "bag"), str(again)]) == 0
        assert run("rx90 bag", ["info", str(again)]) == 0
        assert ("effort in A" in capsys.readouterr().out) == (unit == "mA")
        with AnyReader([again]) as reader:
            assert reader.message_count == len(TIME)
    assert run("rx90 bag", ["compare", str(tmp_path / "mA" / "bag"), str(tmp_path / "mNm" / "bag")]) == 1
    assert "effort is in A in the first bag and in Nm in the second, and not compared" in capsys.readouterr().out


@pytest.mark.parametrize(
    "words", [["info", "log.csv"], ["export", "log.csv", "-o", "t"], ["compare", "log.csv", "log.csv"],
              ["plot", "log.csv", "-o", "p.html"]],
)  # fmt: skip
def test_every_verb_on_a_table_takes_its_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]) -> None:
    """The signal map of a table may have any name, and stand elsewhere than beside it."""
    monkeypatch.chdir(tmp_path)
    write(Path("log.csv"), rows(","))
    write(Path("arm.yaml"), PLAIN)
    assert run("rx90 bag", words) == 2
    assert run("rx90 bag", [*words, "--signals", "arm.yaml"]) == 0


NAMES = ("joint_1", "joint_2")
RNG = np.random.default_rng(12)
TIMES = np.sort(RNG.choice(10**12, 300, replace=False)) + 1_790_000_000 * 10**9  # ns of the wall clock


def odd_numbers(count: int) -> np.ndarray:
    found = RNG.integers(0, 2**64, (count, len(NAMES)), dtype=np.uint64).view(np.float64)
    found[~(np.abs(found) <= 1e9)] = 5e-324
    found[:2] = [[-0.0, 1e9], [0.0, 0.1 + 0.2]]
    return found


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bag") / "run"
    values = [odd_numbers(len(TIMES)) for _ in range(5)]
    series = [
        JointSeries("/joint_states", NAMES, TIMES, *values[:3]),
        JointSeries("/friction_states", NAMES, TIMES[::2].copy(), position=values[3][::2].copy()),
        JointSeries("/rx90_controller/motor_current", NAMES, TIMES, effort=values[4]),
    ]
    write_joint_states(folder, series)
    return folder


def test_a_bag_comes_back_from_csv_to_the_last_bit(bag: Path, tmp_path: Path) -> None:
    """Exported and read again it has the same stamps of the wall clock, and any number of a joint."""
    export_bag(bag, tmp_path / "out")
    assert sorted(file.stem for file in (tmp_path / "out").glob("*.csv")) == sorted(
        file.stem for file in (tmp_path / "out").glob("*.yaml")
    )
    table = read_bag(tmp_path / "out" / "joint_states.csv")["joint_states"]
    recorded = read_bag(bag)["joint_states"]
    np.testing.assert_array_equal(table.stamp_ns, recorded.stamp_ns)
    for field, values in recorded.fields.items():
        assert table.fields[field].tobytes() == values.tobytes()


def test_tables_are_what_others_read(bag: Path, tmp_path: Path) -> None:
    """CSV by pandas and Parquet by pyarrow and pandas have the bag's numbers, under names with units."""
    pd = pytest.importorskip("pandas", reason="pandas is not installed")
    series = read_bag(bag)["friction_states"]
    names = [f"{name} bristle deflection [rad]" for name in NAMES]
    export_bag(bag, tmp_path / "f.csv", topics=["friction_states"])
    with (tmp_path / "f.csv").open(encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["time [s]", *names]
    assert [int(row[0].replace(".", "")) for row in rows[1:]] == series.stamp_ns.tolist()
    table = np.array([[float(text) for text in row[1:]] for row in rows[1:]])
    assert list(pd.read_csv(tmp_path / "f.csv")) == rows[0]
    assert np.array_equal(table, series.position, equal_nan=True)
    export_bag(bag, tmp_path / "f.parquet", topics=["friction_states"])
    frame = pd.read_parquet(tmp_path / "f.parquet")
    assert list(frame) == ["stamp [ns]", "time [s]", *names]
    assert frame["stamp [ns]"].tolist() == series.stamp_ns.tolist()
    assert frame[names].to_numpy().tobytes() == series.position.tobytes()


def test_npz_arrays_go_to_matlab(bag: Path, tmp_path: Path) -> None:
    """Arrays of a topic stand in an NPZ file under names that MATLAB takes; savemat and loadmat give its numbers."""
    export_bag(bag, tmp_path / "j.npz", topics=["joint_states"])
    with np.load(tmp_path / "j.npz") as arrays:
        assert set(arrays) == {"names", "stamp_ns", "time_s", "position_rad", "velocity_rad_s", "effort_Nm"}
        scipy.io.savemat(tmp_path / "j.mat", dict(arrays))
    loaded = scipy.io.loadmat(tmp_path / "j.mat")
    series = read_bag(bag)["joint_states"]
    assert loaded["velocity_rad_s"].tobytes(order="C") == series.velocity.tobytes()
    assert loaded["stamp_ns"].ravel().tolist() == series.stamp_ns.tolist()
    assert [str(name).strip() for name in loaded["names"]] == list(NAMES)


@pytest.mark.parametrize("name", ["one.npz", "one.csv", "one.parquet", "folder"])
def test_a_full_disk_leaves_nothing(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    """Where a table has no room, here by a limit of the size of files: 3, one line, nothing left, and no bus error."""
    if name.endswith("parquet"):
        pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    with files_up_to(2000):
        assert run("rx90 bag", ["export", str(bag), "--output", str(tmp_path / name), "--topic", "joint_states"]) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{name}: cannot be written (" in line
    assert list(tmp_path.iterdir()) == []


def test_a_table_needs_one_set_of_joints(tmp_path: Path) -> None:
    """A topic whose joints change their order is one table; one with other joints in other messages is refused."""
    first = joint_state(10, ["a", "b"], [1.0, 2.0])
    turned = joint_state(20, ["b", "a"], [3.0, 4.0])
    turning = write_ros2(tmp_path / "turning", [("/joints", 10, first), ("/joints", 20, turned)])
    export_bag(turning, tmp_path / "turned.csv")
    assert (tmp_path / "turned.csv").read_text().splitlines()[1:] == ["0.000000010,1,2", "0.000000020,4,3"]
    other = joint_state(30, ["c"], [5.0])
    changing = write_ros2(tmp_path / "changing", [("/joints", 10, first), ("/joints", 30, other)])
    with pytest.raises(BagError, match="several sets of joints: a, b; c"):
        export_bag(changing, tmp_path / "changed.csv")
