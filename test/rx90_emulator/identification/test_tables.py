"""Tables read as they are, by a signal map: CSV, Parquet and NPZ give what a bag of the same numbers gives."""

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from hinge_arm import RATE, Hinge

import rx90_emulator as rx
from rx90_common.base.errors import DONE, REFUSED, ConfigError
from rx90_common.estimation.law import Law, Part
from rx90_emulator.cli.frame import run
from rx90_emulator.identification.output.summary import kept_parts

GEAR, CONSTANT, ZERO = -50.0, 0.08, 0.3
Columns = dict[str, Any]


def write_table(path: Path, columns: Columns) -> Path:
    if path.suffix == ".npz":
        np.savez(path, **columns)
    elif path.suffix == ".parquet":
        pq.write_table(pa.table(columns), path)
    else:
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        path.write_text("\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows)]), encoding="utf-8")
    return path


def write_map(path: Path, **content: object) -> Path:
    """Write a signal map of one motor, whose keys may be changed or, by None, left out."""
    usual: dict[str, object] = {
        "time": {"column": "t", "unit": "ms"},
        "names": ["hinge"],
        "position": {"columns": ["q"], "unit": "deg"},
        "velocity": {"columns": ["dq"], "unit": "rpm"},
        "effort": {"columns": ["i"], "unit": "mA"},
        "gear": [GEAR],
        "torque_constant": [CONSTANT],
        "zero": [ZERO],
    }
    kept = {key: value for key, value in (usual | content).items() if value is not None}
    path.write_text(yaml.safe_dump(kept), encoding="utf-8")
    return path


@dataclass
class Motor:
    """A joint's URDF, friction and bag, and its motor's columns in a laboratory's units."""

    urdf: Path
    bag: Path
    friction: str
    columns: Columns


@pytest.fixture(scope="module")
def motor(hinge: Hinge, tmp_path_factory: pytest.TempPathFactory) -> Motor:
    columns: Columns = {
        "t": 5000.0 + np.arange(len(hinge.position)) * (1000.0 / RATE),
        "q": np.rad2deg((hinge.position[:, 0] + ZERO) * GEAR),
        "dq": hinge.velocity[:, 0] * GEAR * 30.0 / np.pi,
        "i": 1000.0 * hinge.torque[:, 0] / GEAR / CONSTANT,
    }
    return Motor(hinge.urdf, hinge.bag, str(hinge.friction(tmp_path_factory.mktemp("f") / "friction.yaml")), columns)


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".npz"])
def test_friction_against_a_table_is_that_against_a_bag(motor: Motor, tmp_path: Path, suffix: str) -> None:
    """A motor's degrees, rpm and mA with gear, torque constant and zero in the map beside are the joint's states."""
    table = write_table(tmp_path / f"log{suffix}", motor.columns)
    write_map(tmp_path / "log.yaml")
    bag, found = (
        rx.check_friction(motor.friction, [log], rx.RobotOptions(urdf=motor.urdf))[0] for log in (motor.bag, table)
    )
    assert found.passed
    np.testing.assert_allclose(found.torque.recorded, bag.torque.recorded, atol=1e-9)
    np.testing.assert_allclose(found.torque.predicted, bag.torque.predicted, atol=1e-6)
    assert (tmp_path / "log.yaml").is_file()
    assert len(list(tmp_path.iterdir())) == 2  # no bag was made


def test_one_map_serves_many_tables_and_says_what_the_options_say(
    motor: Motor, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--signals` names a map for all tables; gear, constant and zero may stand in it, or be options, not both."""
    table, whole = write_table(tmp_path / "log.csv", motor.columns), write_map(tmp_path / "arm_map.yaml")
    bare = write_map(tmp_path / "bare.yaml", gear=None, torque_constant=None, zero=None)
    words = ["check", motor.friction, str(table), "--urdf", str(motor.urdf), "--signals"]
    options = ["--gear", str(GEAR), "--torque-constant", str(CONSTANT), "--zero", str(ZERO)]
    said = []
    for more in ([str(whole)], [str(bare), *options]):
        assert run("rx90 identify", [*words, *more]) == DONE
        said.append(capsys.readouterr().out)
    assert said[0] == said[1]
    assert run("rx90 identify", [*words, str(whole), *options]) == REFUSED
    assert "--gear beside gear in " in capsys.readouterr().err


def test_a_map_says_what_a_bag_holds(motor: Motor, tmp_path: Path) -> None:
    """A map without columns stands for the options of a bag: zeros are subtracted, wrong ones show."""
    shifted = write_map(tmp_path / "map.yaml", time=None, position=None, velocity=None, effort=None, gear=None,
                        torque_constant=None, zero=[0.4])  # fmt: skip
    plain, same, by_map = (
        rx.check_friction(motor.friction, [motor.bag], rx.RobotOptions(urdf=motor.urdf, **options))[0]
        for options in ({}, {"zero": [0.4]}, {"signals": shifted})
    )
    np.testing.assert_array_equal(by_map.torque.predicted, same.torque.predicted)
    assert by_map.torque.rms[0] > 2.0 * plain.torque.rms[0]


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".npz"])
def test_stamps_and_numbers_are_those_of_the_table(tmp_path: Path, suffix: str) -> None:
    """Whole ns of the wall clock and numbers of two joints, one reversed, come to the last bit; NPZ has rows, too."""
    t = 1_700_000_000_000_000_001 + np.arange(50) * 1_000_003
    q = np.random.default_rng(4).normal(size=(50, 2))
    names = ["q[0]", "q[1]"]
    columns = {"t": t, "q": q} if suffix == ".npz" else {"t": t, "q[0]": q[:, 0], "q[1]": q[:, 1]}
    table = write_table(tmp_path / f"log{suffix}", columns)
    field = {"columns": names, "unit": "rad", "factor": [1, -1]}
    write_map(tmp_path / "log.yaml", time={"column": "t", "unit": "ns"}, names=["a", "b"], position=field,
              velocity=None, effort=None)  # fmt: skip
    series = rx.read_joint_states(table, "joint_states")
    np.testing.assert_array_equal(series.stamp_ns, t)
    np.testing.assert_array_equal(series.position, q * [1, -1])
    assert series.names == ("a", "b")


def test_whole_times_of_few_bits_are_exact(tmp_path: Path) -> None:
    """Milliseconds in 32 bits become ns, which need more."""
    table = write_table(tmp_path / "log.npz", {"t": np.array([1, 4_000_000_000], np.uint32), "q": np.zeros(2)})
    write_map(tmp_path / "log.yaml", velocity=None, effort=None)
    assert rx.read_joint_states(table, "joint_states").stamp_ns.tolist() == [1_000_000, 4_000_000_000_000_000]


@pytest.mark.parametrize(
    ("suffix", "change", "said"),
    [
        (".parquet", {"velocity": {"columns": ["speed"], "unit": "rpm"}}, "no column 'speed'; there are t, q, dq, i"),
        (".csv", {"time": None, "position": None, "velocity": None, "effort": None}, "names no columns of "),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_one_line(
    motor: Motor, tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str, change: dict[str, Any], said: str
) -> None:
    """A map and a table that do not fit each other are refused with the value and what is accepted."""
    table = write_table(tmp_path / f"log{suffix}", motor.columns)
    write_map(tmp_path / "log.yaml", **change)
    words = ["check", motor.friction, str(table), "--urdf", str(motor.urdf)]
    assert run("rx90 identify", words) == REFUSED
    err = capsys.readouterr().err
    assert said in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".npz"])
def test_damaged_tables_are_one_line(motor: Motor, tmp_path: Path, suffix: str) -> None:
    """Cut off or foreign files, absurd numbers and NaN are refused; nothing is left out in silence."""
    write_map(tmp_path / "log.yaml")
    spoilt = motor.columns | {"q": motor.columns["q"].copy()}
    spoilt["q"][7] = np.nan
    table = write_table(tmp_path / f"log{suffix}", spoilt)
    with pytest.raises(rx.Rx90Error, match=r"line \d+: column q is 'nan'; accepted: numbers of"):
        rx.read_joint_states(table, "joint_states")
    table.write_bytes(table.read_bytes()[:-100] if suffix != ".csv" else b"\x00\xff" * 50)
    with pytest.raises(rx.Rx90Error, match=r"damaged|holds no row of numbers"):
        rx.read_joint_states(table, "joint_states")


def test_tables_of_two_arms_are_refused(motor: Motor, tmp_path: Path) -> None:
    """Maps beside tables that say different things of the arm are refused."""
    tables = [write_table(tmp_path / f"{name}.csv", motor.columns) for name in "ab"]
    write_map(tmp_path / "a.yaml")
    write_map(tmp_path / "b.yaml", gear=[GEAR + 1.0])
    with pytest.raises(ConfigError, match=r"b\.yaml says other things of the arm than .*a\.yaml"):
        rx.check_friction(motor.friction, tables, rx.RobotOptions(urdf=motor.urdf))


def test_a_part_whose_values_stay_open_has_a_star() -> None:
    """The element's name is marked."""
    laws = [*[Law(frozenset({Part.EXPONENT}))] * 2, Law()]
    known = [{"alpha": SimpleNamespace(identifiable=identifiable)} for identifiable in (True, False, False)]
    elements = [SimpleNamespace(estimates=estimates) for estimates in known]
    arm, fitted = SimpleNamespace(element_names="abc"), SimpleNamespace(laws=laws)
    result: Any = SimpleNamespace(arm=arm, fitted=fitted, elements=elements)
    assert kept_parts(result) == f"Coulomb + viscous + {Part.EXPONENT.value}: a, b*; * parameters stay open"
