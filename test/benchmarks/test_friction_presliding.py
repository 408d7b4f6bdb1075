"""The benchmark that counts how often the bench's verdicts are wrong: what it keeps of rigs, and what it counts."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.friction_presliding import KINDS, METHODS, RigTable, count, random_rig
from rx90_common.friction.element import FrictionElement


def test_measured_rigs_are_kept_by_sources_seed_and_cycles(tmp_path: Path) -> None:
    """Whoever begins again finds the rigs measured before; not those of other sources, nor a line that is torn."""
    file = tmp_path / "out" / "rigs.csv"
    verdicts = {**dict.fromkeys(METHODS, "right"), "found": 'LuGre; loops and sliding: LuGre, "drift"'}
    RigTable(file, "a", 1, 100).add(0, "LuGre", verdicts)
    RigTable(file, "a", 1, 100).add(1, "Stribeck", {**verdicts, "drift": "wrong"})
    with file.open("a", encoding="utf-8") as stream:
        stream.write("a,1,100,2,LuGre,right,ri")
    found = RigTable(file, "a", 1, 100).rows
    assert sorted(found) == [(0, "LuGre"), (1, "Stribeck")]
    assert found[1, "Stribeck"]["drift"] == "wrong"
    assert found[0, "LuGre"]["found"] == verdicts["found"]
    for other in (("b", 1, 100), ("a", 2, 100), ("a", 1, 200)):
        assert RigTable(file, *other).rows == {}


def test_bound_of_a_rate_is_that_of_the_binomial(capsys: pytest.CaptureFixture[str]) -> None:
    """Of 40 rigs none wrong: the chance of that is 5 % at the bound that is printed; one wrong rig is named."""
    rows = [
        {"joint": kind, "rig": str(number), "found": "Maxwell slip", **dict.fromkeys(METHODS, "right")}
        for number in range(8)
        for kind in KINDS
    ]
    rows[7]["both"] = "wrong"
    assert count(rows) == {"loops and sliding": 0.0, "drift": 0.0, "both": 1 / 40}
    out = capsys.readouterr().out
    assert pytest.approx(7.2, abs=0.05) == 100 * (1.0 - 0.05 ** (1 / 40))
    assert "drift: 0 of 40 wrong; below 7.2 % with 95 % confidence" in out
    assert "both: 1 of 40 wrong; below 11.3 %" in out  # 39/40 and 40/40 together have 5 % there
    assert "rig 1, LuGre: Maxwell slip" in out


def test_rigs_are_the_same_for_a_seed_and_differ_by_number() -> None:
    """A rig is known by seed, number and kind of its joint."""
    first, same, other = (random_rig(1, number, "LuGre").plant for number in (0, 0, 1))
    assert first == same
    assert first is not None
    assert other is not None
    assert isinstance(first.joint, FrictionElement)
    assert first.joint != other.joint
