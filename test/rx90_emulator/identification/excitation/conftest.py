"""What tests of excitation runs leave out where others look at it."""

from __future__ import annotations

import pytest

from rx90_emulator.identification.excitation import instruments


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the simulations of the closed loop, which other tests look at."""
    monkeypatch.setattr(instruments, "_MAX_ROUNDS", 0)
