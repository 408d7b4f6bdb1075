"""The animation on the first page: short, small, and of the arm that the closed loop has moved."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import rx90_emulator as rx
from tools import arm_animation

WEBP = Path(__file__).resolve().parents[2] / "docs/images/arm.webp"


def test_the_animation_is_small_and_moves() -> None:
    """It has at least 40 pictures, less than 400 kB, and the arm is elsewhere in the last than in the first."""
    assert WEBP.stat().st_size < 400_000
    with Image.open(WEBP) as animation:
        assert getattr(animation, "n_frames", 1) >= 40
        first = np.asarray(animation.convert("L"), dtype=float)
        animation.seek(animation.n_frames - 1)
        last = np.asarray(animation.convert("L"), dtype=float)
    assert np.mean(np.abs(last - first) > 30.0) > 0.01


def test_the_trace_ends_at_the_spot(shipped: rx.Setup, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the end of the line the picture is red along all of it, at the start nowhere there."""
    monkeypatch.setattr(arm_animation, "_PIXELS", 120)
    task = rx.load_task()
    plan = rx.plan_line(shipped, task)
    start, end = (arm_animation.frame(shipped, task, tuple(plan.position[k])) for k in (0, -1))

    def red(picture: np.ndarray) -> int:
        channels = picture.astype(int)
        return int(((channels[..., 0] > 100) & (channels[..., 1] < 60) & (channels[..., 2] < 60)).sum())

    assert red(end) > red(start) + 30
