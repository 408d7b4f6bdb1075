"""`rx90 bag export` and `import` of what it wrote: names, units, every bit, memory, interrupts, refusals."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from bag_making import joint_state, write_ros2
from processes import files_up_to

from rx90_common.bags.exporting import export_bag
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.reading import read_bag
from rx90_common.bags.writing import write_joint_states
from rx90_common.base.errors import BagError
from rx90_emulator.cli.frame import run

NAMES = ("joint_1", "joint_2")
RNG = np.random.default_rng(12)
TIMES = np.sort(RNG.choice(10**12, 300, replace=False)) + 1_790_000_000 * 10**9  # ns of the wall clock


def odd_numbers(count: int) -> np.ndarray:
    """Return numbers of all sizes up to 1e9: any bits, both zeros, the smallest."""
    found = RNG.integers(0, 2**64, (count, len(NAMES)), dtype=np.uint64).view(np.float64)
    found[~(np.abs(found) <= 1e9)] = 5e-324
    found[:2] = [[-0.0, 1e9], [0.0, 0.1 + 0.2]]
    return found


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bag with three topics, one of them of a current."""
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
    assert series.position is not None
    assert np.array_equal(table, series.position, equal_nan=True)
    export_bag(bag, tmp_path / "f.parquet", topics=["friction_states"])
    frame = pd.read_parquet(tmp_path / "f.parquet")
    assert list(frame) == ["stamp [ns]", "time [s]", *names]
    assert frame["stamp [ns]"].tolist() == series.stamp_ns.tolist()
    assert frame[names].to_numpy().tobytes() == series.position.tobytes()


def test_npz_arrays_go_to_matlab(bag: Path, tmp_path: Path) -> None:
    """Arrays of a topic stand in an NPZ file under names that MATLAB takes; savemat and loadmat give its numbers."""
    export_bag(bag, tmp_path / "out", kind=".npz")
    with np.load(tmp_path / "out" / "friction_states.npz") as arrays:
        assert set(arrays) == {"names", "stamp_ns", "time_s", "bristle_deflection_rad"}
    with np.load(tmp_path / "out" / "joint_states.npz") as arrays:
        scipy.io.savemat(tmp_path / "all.mat", dict(arrays))
    loaded = scipy.io.loadmat(tmp_path / "all.mat")
    series = read_bag(bag)["joint_states"]
    assert series.velocity is not None
    assert loaded["velocity_rad_s"].tobytes(order="C") == series.velocity.tobytes()
    assert loaded["stamp_ns"].ravel().tolist() == series.stamp_ns.tolist()
    assert [str(name).strip() for name in loaded["names"]] == list(NAMES)


@pytest.mark.parametrize("name", ["all.npz", "one.csv", "one.parquet", "folder"])
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
