"""What the page says of recordings, as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rx90_common.base.quoting import plain
from rx90_common.base.rates import NANOSECONDS
from rx90_emulator.view.bags.difference import Difference
from rx90_emulator.view.bags.recording import Recording
from rx90_emulator.view.bags.times import seconds
from rx90_emulator.view.bags.track import Track

_MOST_CHANGES = 30
_MOST_GAPS = 5


def recording_text(recording: Recording, robot: str, origin_ns: int) -> str:
    """Return what a bag holds: robot, times, topics with their rates, gaps, and what it lacks.

    Args:
        recording: of a bag.
        robot: its name.
        origin_ns: where the page's time is 0.
    """
    arm = recording.arm
    lasting = (arm.end_ns - arm.begin_ns) / NANOSECONDS
    gaps = arm.gaps()
    lines = [
        f"**{_escaped(recording.path.name)}** ({recording.kind}), robot {_escaped(robot)}, "
        f"{lasting:.3f} s from stamp {seconds(arm.begin_ns)} s"
    ]
    lines += [f"- Not in it: {', '.join(recording.lacking)}"] if recording.lacking else []
    lines += [f"- {_escaped(note)}" for note in recording.notes]
    if len(gaps):
        shown = ", ".join(f"{seconds(a - origin_ns)} to {seconds(b - origin_ns)} s" for a, b in gaps[:_MOST_GAPS])
        more = f" and {len(gaps) - _MOST_GAPS:,} more" if len(gaps) > _MOST_GAPS else ""
        lines.append(f"- Gaps, in which no arm is drawn: {shown}{more}")
    lines.append("")
    steps = len(arm.time_ns) - 1
    for topic in recording.topics:
        rate = f", {topic.count * steps / ((steps + 1) * lasting):.4g} Hz" if topic.is_joint_state else ""
        lines.append(f"- {_escaped(topic.name)}: {topic.count:,}{rate}")
    return "\n".join(lines + _changes(recording, origin_ns))


def _changes(recording: Recording, origin_ns: int) -> list[str]:
    if not recording.changes:
        return []
    lines = ["", "| at s | parameter changed | to |", "|---:|---|---|"]
    for change in recording.changes[:_MOST_CHANGES]:
        name = _escaped(f"{change.node} {change.name}")
        lines.append(f"| {seconds(change.stamp_ns - origin_ns)} | {name} | {_escaped(change.value)} |")
    left = len(recording.changes) - _MOST_CHANGES
    return lines + ([f"| | and {left:,} more: rx90_bag info | |"] if left > 0 else [])


def path_error_text(name: str, error: Track, origin_ns: int) -> str:
    """Return the largest path error of a recording and when it was, on the time of the page."""
    values = error.values["position"][:, 0]
    if not np.isfinite(values).any():
        return f"{_escaped(name)}: its set-points never move"
    row = int(np.nanargmax(values))
    at = seconds(int(error.time_ns[row]) - origin_ns)
    return f"{_escaped(name)}: largest path error {1e3 * values[row]:.3f} mm, at {at} s"


def difference_text(found: Difference, names: Sequence[str], origin_ns: int, shift_ns: int) -> str:
    """Return how far two recordings differ, and how they were compared.

    Args:
        found: of the recordings.
        names: of both bags.
        origin_ns: where the page's time is 0.
        shift_ns: what the stamps of the second were moved by.
    """
    first, second = map(_escaped, names)
    tip = found.worst_tip
    lines = [
        f"**{second}** (ghost) less **{first}**: tips at most {1e3 * tip.value:.4g} mm apart, at "
        f"{seconds(tip.time_ns - origin_ns)} s"
    ]
    if found.exact < 1.0:
        lines += ["", f"- {1.0 - found.exact:.1%} of the stamps of {first} fall between two of {second}: interpolated"]
    if shift_ns:
        lines += ["", f"- Stamps of {second} were moved by {shift_ns / NANOSECONDS:+.9f} s"]
    return "\n".join(lines)


def joint_differences(found: Difference, origin_ns: int) -> str:
    """Return the largest difference of each joint as a table; `origin_ns` is where the page's time is 0."""
    lines = ["| joint | largest, mrad | at s |", "|---|---:|---:|"]
    for name, worst in zip(found.joints.names, found.worst_joints, strict=True):
        lines.append(f"| {_escaped(name)} | {1e3 * worst.value:.4g} | {seconds(worst.time_ns - origin_ns)} |")
    return "\n".join(lines)


def _escaped(text: str) -> str:
    """Return text from outside that Markdown takes as it is."""
    return "".join(f"\\{c}" if c in r"\`*_{}[]<>()#+-!|" else c for c in plain(text))
