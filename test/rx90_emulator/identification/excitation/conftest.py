"""What tests of excitation runs leave out where others look at it."""

from __future__ import annotations

import pytest

from rx90_common.report import page
from rx90_emulator.identification.excitation import instruments


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out what other tests look at: simulations of the closed loop, and plots."""
    monkeypatch.setattr(instruments, "_MAX_ROUNDS", 0)
    for drawn in ("as_svg", "plot_json"):
        monkeypatch.setattr(page, drawn, lambda *_: "")
