"""The benchmark that counts how often the bench's verdicts are wrong."""

from __future__ import annotations

import pytest

from benchmarks.friction_presliding import KINDS, METHODS, count


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
