"""Recorded series at any time, and the curves that are drawn of long ones."""

from __future__ import annotations

from contextlib import suppress
from time import monotonic
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import interp1d

from rx90_common.bags.joint_series import JointSeries
from rx90_emulator.view.player import Playback
from rx90_emulator.view.track import Track

STEP = 1_000_000


def track(stamps: np.ndarray, values: np.ndarray) -> tuple[Track, int]:
    """Return a track of positions, shape (n, k)."""
    names = tuple(f"j{k}" for k in range(values.shape[1]))
    return Track.of(JointSeries("/joint_states", names, stamps.astype(np.int64), values))


def test_states_between_samples_and_in_gaps() -> None:
    """A sample is given as it is, a time between two as on the line between them, and nothing in a gap or outside."""
    random = np.random.default_rng(1)
    stamps = np.array([0, 1, 2, 3, 4, 5, 9, 10, 11]) * STEP + 10**18  # of the wall clock; three are missing
    values = random.normal(size=(9, 2))
    found, resets = track(stamps, values)
    assert resets == 0
    np.testing.assert_array_equal(found.at("position", stamps), values)
    wanted = np.sort(random.integers(stamps[0] - 2 * STEP, stamps[-1] + 2 * STEP, 500))
    oracle = interp1d(
        (stamps - stamps[0]).astype(float), values, axis=0, bounds_error=False, fill_value=np.nan
    )((wanted - stamps[0]).astype(float))  # fmt: skip
    oracle[(wanted > stamps[5]) & (wanted < stamps[6])] = np.nan
    np.testing.assert_allclose(found.at("position", wanted), oracle, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.gaps(), [[stamps[5], stamps[6]]])


def test_messages_out_of_order_repeated_and_after_a_reset() -> None:
    """Messages are put in order of time, repetitions count once, and after a reset what comes before it is left out."""
    before = np.arange(50) * STEP
    after = np.array([0, 1, 1, 1, 3, 2, 4, 5, 6, 7]) * STEP
    stamps = np.concatenate([before, after])
    found, resets = track(stamps, np.arange(60.0)[:, None])
    assert resets == 1
    np.testing.assert_array_equal(found.time_ns, np.arange(8) * STEP)
    np.testing.assert_array_equal(found.values["position"][:, 0], [50, 51, 55, 54, 56, 57, 58, 59])


@pytest.mark.parametrize(("count", "buckets"), [(100_000, 40), (37, 40), (1000, 999)])
def test_envelope_keeps_every_peak(count: int, buckets: int) -> None:
    """However few points a curve is drawn with, it passes through the extremes of all samples of each bucket."""
    random = np.random.default_rng(count)
    values = random.normal(size=(count, 2))
    values[count // 3, 0], values[count // 2, 1] = 50.0, -70.0
    found, _ = track(np.arange(count) * STEP, values)
    end = (count - 1) * STEP
    time, curve = found.envelope("position", 0, end, buckets)
    assert len(time) == 2 * buckets
    assert (np.diff(time) > 0).all()
    assert (curve[:, 0].max(), curve[:, 1].min()) == (50.0, -70.0)
    edges = [end * k // buckets for k in range(buckets + 1)]
    for k in range(buckets):
        inside = values[(np.arange(count) * STEP >= edges[k]) & (np.arange(count) * STEP < edges[k + 1])]
        pair = curve[2 * k : 2 * k + 2]
        assert edges[k] == time[2 * k]
        if len(inside):
            assert (pair.max(axis=0) >= inside.max(axis=0)).all()
            assert (pair.min(axis=0) <= inside.min(axis=0)).all()


def test_envelope_shows_a_gap_and_a_steep_line_as_they_are() -> None:
    """Where samples are missing a curve has nothing, and where it has more points than samples it is the line."""
    stamps = np.concatenate([np.arange(100), np.arange(200, 300)]) * STEP
    found, _ = track(stamps, 3e-9 * stamps[:, None].astype(float))
    time, curve = found.envelope("position", 0, 299 * STEP, 60)
    inside = (time > 105 * STEP) & (time < 195 * STEP)
    assert np.isnan(curve[inside]).all()
    assert inside.sum() > 30
    time, curve = found.envelope("position", 10 * STEP, 20 * STEP, 100)
    np.testing.assert_allclose(curve[:, 0], 3e-9 * time, rtol=0, atol=4e-9)


def test_time_of_a_playback() -> None:
    """Time runs at the chosen speed while it plays, stops at the end or begins again, and stays within the record."""
    fields = [SimpleNamespace(value=value, label="", on_update=id, on_click=id) for value in (0.0, "", "1", False)]
    _, button, speed, loop = fields
    handlers: list[Any] = []
    button.on_click = handlers.append
    adders = ("add_slider", "add_button", "add_dropdown", "add_checkbox")
    gui = {adder: lambda *_, field=field, **__: field for adder, field in zip(adders, fields, strict=True)}
    page: Any = SimpleNamespace(gui=SimpleNamespace(**gui), later=lambda function: function())
    play = Playback(page, 10.0, [])

    def press() -> None:
        with suppress(StopIteration):  # a coroutine that waits for nothing
            handlers[0](SimpleNamespace(client_id=1)).send(None)

    start = monotonic() + 10.0
    play.advance(start)
    assert play.time == 0.0
    press()
    speed.value = "0.5"
    play.advance(start + 4.0)
    assert play.time == pytest.approx(2.0)
    play.go_to(99.0)
    assert (play.time, play.playing) == (10.0, False)
    press()  # at its end: from the beginning
    assert (play.time, play.playing) == (0.0, True)
    speed.value = "10"
    play.advance(start + 14.0)
    assert (play.time, play.playing) == (10.0, False)
    press()
    loop.value = True
    play.advance(start + 16.3)
    assert play.time == pytest.approx(3.0)
    assert play.playing
