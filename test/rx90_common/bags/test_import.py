"""Logs in columns become bags of joint states: units, delimiters, headers, damaged rows."""

from __future__ import annotations

from datetime import datetime, timezone
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from processes import files_up_to
from rosbags.highlevel import AnyReader

from rx90_common.bags import logs as log_reading
from rx90_common.bags.exporting import export_bag
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.logs import import_logs
from rx90_common.bags.mapping import LogMapping
from rx90_common.bags.plotting import plot_bags
from rx90_common.bags.reading import read_joint_states
from rx90_emulator.cli.frame import run

TIME = np.array([0.5, 0.75, 1.25])
POSITION = np.array([[10.0, -20.0], [11.5, -21.25], [12.0, -22.0]])
PLAIN = """\
time: {column: 1, unit: s}
topics:
  joint_states:
    names: [a, b]
    position: {columns: [2, 3], unit: rad}
"""


NAMED = "time: {column: t, unit: s}\nnames: [a]\nposition: {columns: [q], unit: rad}\n"
MAY = int(datetime(2024, 5, 1, 12, tzinfo=timezone.utc).timestamp()) * 10**9


def write(path: Path, text: str, encoding: str = "utf-8") -> Path:
    """Write a file."""
    path.write_text(text, encoding=encoding)
    return path


def imported(tmp_path: Path, mapping: str, log: str, topic: str = "joint_states", encoding: str = "utf-8",
             skip_corrupt: bool = False) -> JointSeries:  # fmt: skip
    """Return what the bag that is made of a log holds."""
    chosen = LogMapping.load(write(tmp_path / "mapping.yaml", mapping))
    path = write(tmp_path / "log.csv", log, encoding)
    import_logs([(path, chosen)], tmp_path / "bag", skip_corrupt=skip_corrupt)
    return read_joint_states(tmp_path / "bag", topic)


def rows(delimiter: str, decimal: str = ".", end: str = "") -> str:
    """Return times and positions as text."""
    table = np.column_stack([TIME, POSITION])
    return "\n".join(delimiter.join(str(x).replace(".", decimal) for x in row) + end for row in table)


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        (rows(","), "utf-8"),
        (rows(", ", end=","), "utf-8-sig"),
        (rows(";", end=";a,b,c,1,2,3,4,d"), "utf-8"),
        (rows(";", ","), "utf-8"),
        ('"t";"a";"b"\n"' + rows('";"', ",", '"').replace("\n", '\n"'), "utf-8"),
        ("time;q a;q b\n[s];[rad];[rad]\n" + rows(";"), "utf-16"),
        (" " + rows("\t    "), "utf-8"),
        ("\n\n" + rows("   "), "latin-1"),
        ("% of the 3rd run\n" + rows(";").replace("\n", "\r\n") + "\n\n", "utf-8"),
        ('"t","a","b"\n"' + rows('","').replace("\n", '"\n"') + '"', "utf-8"),
        ("t,a,b,tau\n" + rows(",", end=","), "utf-8"),  # a column that is empty and not used
    ],
)
def test_delimiter_decimal_sign_and_header_are_found_out(tmp_path: Path, text: str, encoding: str) -> None:
    """Commas, semicolons, tabs, blanks, decimal commas, headers, comments and encodings give the same numbers."""
    found = imported(tmp_path, PLAIN, text, encoding=encoding)
    assert found.stamp_ns.tolist() == [500_000_000, 750_000_000, 1_250_000_000]
    assert found.names == ("a", "b")
    assert np.array_equal(found.position, POSITION)
    assert found.velocity is None
    assert found.effort is None


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
    mapping = f"rate: 4\ntopics: {{joint_states: {{names: [a, b], {field}: {{columns: [y, x], {unit}}}}}}}\n"
    found = imported(tmp_path, mapping, f"# x y\n{values[1]} {values[0]}\n{values[1]} {values[0]}\n")
    assert getattr(found, field)[1] == pytest.approx(expected, rel=1e-14)
    assert found.stamp_ns.tolist() == [0, 250_000_000]


@pytest.mark.parametrize(("unit", "scale"), [("s", 9), ("ms", 6), ("us", 3), ("ns", 0)])
def test_stamps_of_the_wall_clock_are_exact(tmp_path: Path, unit: str, scale: int) -> None:
    """A stamp of 19 digits keeps its last ns in every unit, which floating point does not."""
    stamps = [1_700_000_000_123_456_789, 1_700_000_000_123_456_790]
    log = "\n".join(f"{Decimal(s).scaleb(-scale)},1,2" for s in stamps)
    assert imported(tmp_path, PLAIN.replace("unit: s", f"unit: {unit}"), log).stamp_ns.tolist() == stamps


def test_rows_of_a_rate_lie_at_the_nearest_ns(tmp_path: Path) -> None:
    """Without a column of times rows are numbered by the rate; one column may stand for two quantities of two units."""
    mapping = PLAIN.replace("time: {column: 1, unit: s}", "rate: 3").replace("unit: rad", "unit: deg")
    found = imported(tmp_path, mapping + "    effort: {columns: [3, 2], unit: mA, factor: [1, -2]}\n", rows(","))
    assert found.stamp_ns.tolist() == [0, 333_333_333, 666_666_667]
    np.testing.assert_allclose(found.position, np.deg2rad(POSITION), rtol=1e-14)
    np.testing.assert_allclose(found.effort, POSITION[:, ::-1] * [1e-3, -2e-3], rtol=1e-14)


@pytest.mark.parametrize(
    ("times", "left"), [("0 9 1 3", "0 1 3"), ("5 0 1 2", "0 1 2"), ("0 3 2 1 4", "0 3 4"), ("9 8 1 2 7 3", "1 2 3")]
)
def test_times_out_of_order_cost_the_fewest_rows(tmp_path: Path, times: str, left: str) -> None:
    """A longest increasing part is left, of several that with the shortest steps, whatever stands first."""
    log = "\n".join(f"{time},1,2" for time in times.split())
    found = imported(tmp_path, PLAIN, log, skip_corrupt=True)
    assert found.stamp_ns.tolist() == [int(time) * 10**9 for time in left.split()]


@pytest.mark.parametrize("zone", ["", "Z", "+02:00"])
@pytest.mark.parametrize("between", ["T", " "])
def test_times_of_iso_8601_are_exact(tmp_path: Path, zone: str, between: str) -> None:
    """Dates with a time of day are read to the ns, with or without a zone; UTC without one."""
    text = "\n".join(f"2024-05-01{between}12:00:0{k}.123456789{zone},{k},{k}" for k in range(3))
    hour = 12 - 2 * (zone == "+02:00")
    begin = int(datetime(2024, 5, 1, hour, tzinfo=timezone.utc).timestamp()) * 10**9 + 123_456_789
    assert imported(tmp_path, PLAIN, f"t,a,b\n{text}").stamp_ns.tolist() == [begin + k * 10**9 for k in range(3)]


@pytest.mark.parametrize(
    ("log", "stamps", "positions"),
    [
        ("t;q\n0;0,000000\n1;0,001000\n", [0, 10**9], [0.0, 1e-3]),
        ("t,q\n0,0.5,\n1,0.25,\n", [0, 10**9], [0.5, 0.25]),
        ("t;q\n2024-05-01 12:00:00,000;0,0\n2024-05-01 12:00:00,100;0,25\n", [MAY, MAY + 10**8], [0.0, 0.25]),
    ],
)
def test_named_columns_of_usual_programs_are_read(
    tmp_path: Path, log: str, stamps: list[int], positions: list[float]
) -> None:
    """Whole numbers beside decimals; rows that end in a delimiter; times with a blank and a decimal comma."""
    found = imported(tmp_path, NAMED, log)
    assert found.stamp_ns.tolist() == stamps
    assert found.position[:, 0].tolist() == positions  # type: ignore[index]


@pytest.mark.parametrize(
    ("log", "said"),
    [
        ("t,x,q\n0.0,0.0,\n0.1,0.1,\n", "2 corrupt rows, line 2, 3 (line 2: column q is empty)"),
        ('t,q\n0.0,"1,100"\n0.1,"1,101"\n', "(line 2: column q is '1,100'); accepted: columns as in"),
        ('t,q\n0.0,"0,0000"\n0.1,"0,0010"\n', "(line 2: column q is '0,0000')"),
    ],
)
def test_what_a_cell_holds_is_told_not_the_header(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], log: str, said: str
) -> None:
    """One line names the cell, where "no column 't'; there are no names" stood beside a header."""
    write(tmp_path / "m.yaml", NAMED)
    paths = str(write(tmp_path / "log.csv", log)), str(tmp_path / "bag")
    assert run("rx90 bag", ["import", *paths, "--signals", str(tmp_path / "m.yaml")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line


@pytest.mark.parametrize(("cells", "where"), [("1,,2", "column 2"), ("1,2,", "column 3"), (",1,2", "time")])
def test_empty_cells_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str], cells: str, where: str) -> None:
    """An empty cell of a column that is read, the last one too, is called so, with line and column."""
    log = write(tmp_path / "log.csv", f"t,a,b\n0,1,2\n{cells}\n3,1,2\n")
    mapping = write(tmp_path / "m.yaml", PLAIN)
    assert run("rx90 bag", ["import", str(log), str(tmp_path / "bag"), "--signals", str(mapping)]) == 2
    is_word = "" if where == "time" else "is "
    assert f"1 corrupt row, line 3 (line 3: {where} {is_word}empty" in capsys.readouterr().err


def test_several_topics(tmp_path: Path) -> None:
    """Columns of one file become two topics of one bag."""
    mapping = """\
time: {column: 1, unit: ms}
topics:
  joint_states: {names: [a], position: {columns: [q], unit: rad}, effort: {columns: [2], unit: Nm}}
  reference: {names: [a], position: {columns: [3], unit: deg}}
"""
    first = imported(tmp_path, mapping, "t,tau,r,q\n10,5,180,1\n20,6,90,2")
    assert (first.stamp_ns.tolist(), first.position.tolist()) == ([10**7, 2 * 10**7], [[1.0], [2.0]])  # type: ignore[union-attr]
    assert first.effort.tolist() == [[5.0], [6.0]]  # type: ignore[union-attr]
    assert read_joint_states(tmp_path / "bag", "reference").position == pytest.approx(np.array([[np.pi], [np.pi / 2]]))


DAMAGED = """\
3047.69,1,2
-0.12,253,253
0.79,-1125095600160866859566323842395765244,1
0,0,0
abc,1,2
3047.70,1,2
3047.71,1
3047.71,nan,2
3047.72,1,2
3047.72,1,2
3047.73,1e30,2
9999.0,1,2
3047.74,1,2
"""


def test_damaged_rows_are_refused_or_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Torn rows, what is no number, absurd numbers and times out of order are refused, or left out, line by line."""
    log, mapping = write(tmp_path / "log.csv", DAMAGED), write(tmp_path / "m.yaml", PLAIN)
    words = ["import", str(log), str(tmp_path / "bag"), "--signals", str(mapping)]
    assert run("rx90 bag", words) == 2
    said = capsys.readouterr().err
    assert "9 corrupt rows, line 2, 3, 4, 5, 7, 8, 10, 11, 12 (line 2: time '-0.12'" in said
    assert said.count("\n") == 1
    assert not (tmp_path / "bag").exists()
    assert run("rx90 bag", [*words, "--skip-corrupt"]) == 0
    said = capsys.readouterr().out
    assert "/joint_states: 2 joints, 4 of 13 rows" in said
    assert "left out: 9 corrupt rows, line 2, 3, 4, 5, 7, 8, 10, 11, 12" in said
    stamps = read_joint_states(tmp_path / "bag", "joint_states").stamp_ns
    assert stamps.tolist() == [3_047_690_000_000, 3_047_700_000_000, 3_047_720_000_000, 3_047_740_000_000]


EXACT = "delimiter: ','\nheader: 1\nexact: true\n"
"""What is in the mapping of an exported file, too."""


@pytest.mark.parametrize(
    ("change", "log", "said"),
    [
        (("[2, 3]", "[2]"), b"1,2,3", "joint_states.position.columns is [2]; accepted: a list of 2, one for each name"),
        (("[2, 3]", "[2, 4]"), b"1,2,3", "log.csv: no column 4; accepted: 1 to 3"),
        (("[2, 3]", "[2, qb]"), b"t,qa,qc\n1,2,3", "log.csv: no column 'qb'; there are t, qa, qc"),
        (("[2, 3]", "[2, qb]"), b"t,qb,qb\n1,2,3", "log.csv: more than one column 'qb'; there are t, qb, qb"),
        (("[2, 3]", "[2, 0]"), b"1,2,3", "position.columns[1] is 0; accepted: the number of a column, from 1 on, or"),
        (("rad", "rad, factor: [1, 0]"), b"1,2,3", "position.factor[1] is 0; accepted: a finite number other than 0"),
        (("[2, 3]", "[2, 2]"), b"1,2,3", "position.columns is [2, 2]; accepted: a list of columns, one for each name"),
        (
            ("[a, b]", '[a, "b\\0"]'),
            b"1,2,3",
            "joint_states.names is ['a', 'b\\x00']; accepted: a list of texts",
        ),
        (("", ""), b"t,qa,qb\n", "log.csv: holds no row of numbers"),
        (("", ""), b"x,a,3\n", "log.csv: every row is corrupt: 1 corrupt row, line 1 (line 1: col"),
        (("", ""), b"\xff\xfe1", "log.csv: holds no row of numbers"),
        (EXACT, b"t,a,b\n" + bytes(2_000_000), "log.csv: no column 2; accepted: 1 to 1"),
        (EXACT, b"\xff\xfe", "log.csv: holds no row of numbers"),
        (EXACT, b"t,a,b\n0,1e999,2\n", "every row is corrupt: 1 corrupt row, line 2 (line 2: column 2 is '1e"),
        (EXACT, b"t,a,b\n0,1,2\n1,2,3_0\n", "log.csv: 1 corrupt row, line 3 (line 3: column 3 is '3_0'"),
        (EXACT, b"t,a,b\n1_0,1,2\n", "(line 2: time '1_0'"),
        (EXACT, b"t,a,b\n2147483648,1,2\n", "(line 2: time '2147483648'; accepted: 0 to 2147483648 s, or ISO"),
        (EXACT, b"t,a,b\n0,1,\0\n", "(line 2: column 3 is '\\x00'"),
    ],
)
def test_what_does_not_fit_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str] | str, log: bytes, said: str
) -> None:
    """A mapping and a log that do not fit each other, lines without an end, torn encodings, numbers of Python alone.

    Each is refused in one line with the value and what is accepted; nothing is made.
    """
    mapping = PLAIN + change if isinstance(change, str) else PLAIN.replace(*change)
    (tmp_path / "log.csv").write_bytes(log)
    write(tmp_path / "m.yaml", mapping)
    words = ["import", str(tmp_path / "log.csv"), str(tmp_path / "bag"), "--signals", str(tmp_path / "m.yaml")]
    assert run("rx90 bag", words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert sorted(file.name for file in tmp_path.iterdir()) == ["log.csv", "m.yaml"]


@pytest.mark.parametrize("limit", [30_000, 100_000])
@pytest.mark.parametrize("exact", [False, True])
def test_a_full_disk_leaves_no_part_of_a_bag(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], limit: int, exact: bool
) -> None:
    """Where the rows on their way, or the bag, have no room: 3, one line, and neither bag nor folders above it."""
    numbers = np.random.default_rng(1).standard_normal((2000, 2))  # which no compression shortens
    lines = (f"{k / 1000},{','.join(map(repr, row))}" for k, row in enumerate(numbers.tolist()))
    log = write(tmp_path / "log.csv", "\n".join(["t,a,b", *lines]))
    write(tmp_path / "log.yaml", PLAIN + EXACT * exact)
    with files_up_to(limit):
        assert run("rx90 bag", ["import", str(log), str(tmp_path / "new" / "bag")]) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert line == f"rx90 bag: {tmp_path}/new/bag: cannot be written (File too large)"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["log.csv", "log.yaml"]


def test_what_is_left_out_does_not_depend_on_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows out of order anywhere: as few are left out, and the same ones, as where all rows are looked at at once."""
    rng = np.random.default_rng(5)
    times = np.arange(400)
    times[rng.integers(0, 400, 40)] = rng.integers(0, 400, 40)
    times[150:160] = times[150:160][::-1]
    log = "\n".join(f"{time},1,2" for time in times)
    whole = imported(tmp_path, PLAIN, log, skip_corrupt=True).stamp_ns
    longest = [0] * 400
    for k in range(400):  # the textbook's dynamic programme
        longest[k] = 1 + max((longest[i] for i in range(k) if times[i] < times[k]), default=0)
    assert len(whole) == max(longest)
    monkeypatch.setattr(log_reading, "_BLOCK", 11)
    (tmp_path / "second").mkdir()
    again = imported(tmp_path / "second", PLAIN, log, skip_corrupt=True).stamp_ns
    assert again.tolist() == whole.tolist()


def test_damaged_lines_of_an_exported_file_are_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """--skip-corrupt leaves out lines of an exact log that hold no time and numbers, also its first, and says which."""
    write(tmp_path / "log.yaml", PLAIN + EXACT)
    log = write(tmp_path / "log.csv", "t,a,b\n1\n1,1,2\n2,x,2\n\n4,nan,2\n3,1,2\nlater,1,2\n")
    assert run("rx90 bag", ["import", str(log), str(tmp_path / "bag")]) == 2
    assert run("rx90 bag", ["import", "--skip-corrupt", str(log), str(tmp_path / "bag")]) == 0
    said = capsys.readouterr().out
    assert "/joint_states: 2 joints, 3 of 6 rows" in said
    assert "left out: 3 corrupt rows, line 2, 4, 8 (line 2: 1 field, others have 3)" in said
    found = read_joint_states(tmp_path / "bag", "joint_states")
    assert found.stamp_ns.tolist() == [10**9, 3 * 10**9, 4 * 10**9]
    write(log, "t,a,b\nx,1,2\n")
    assert run("rx90 bag", ["import", "--skip-corrupt", str(log), str(tmp_path / "none")]) == 2
    assert "every row is corrupt: 1 corrupt row, line 2 (line 2: time 'x'" in capsys.readouterr().err


def test_efforts_in_amperes_stay_amperes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Currents are called A in the bag, its table, plots, comparisons and exports, and on the way back; torques Nm."""
    for unit in ("mA", "mNm"):
        mapping = PLAIN.replace("position: {columns: [2, 3], unit: rad}", f"effort: {{columns: [2, 3], unit: {unit}}}")
        folder = tmp_path / unit
        folder.mkdir()
        series = imported(folder, mapping, rows(","))
        assert series.effort is not None
        np.testing.assert_array_equal(series.effort, POSITION * 1e-3)
        label = f"effort [{unit.removeprefix('m')}]"
        assert series.quantities["effort"] == series.take(slice(0, 2)).select(["b"]).quantities["effort"] == label
        (plot,) = plot_bags([folder / "bag"])
        assert plot.panels[0].label == label.replace(" [", ", ").removesuffix("]")
        tables, again = folder / "tables", folder / "again"
        export_bag(folder / "bag", tables)
        assert (tables / "joint_states.csv").read_text().splitlines()[0] == f"time [s],a {label},b {label}"
        export_bag(folder / "bag", folder / "a.npz")
        assert f"joint_states_effort_{label[8:-1]}" in np.load(folder / "a.npz")
        assert run("rx90 bag", ["import", str(tables), str(again)]) == 0
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
def test_every_verb_that_reads_a_table_takes_its_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    """The signal map of a table may have any name, and stand elsewhere than beside it."""
    monkeypatch.chdir(tmp_path)
    write(Path("log.csv"), rows(","))
    write(Path("arm.yaml"), PLAIN)
    assert run("rx90 bag", words) == 2
    assert run("rx90 bag", [*words, "--signals", "arm.yaml"]) == 0
