"""What the running nodes say of themselves, as HTML."""

from __future__ import annotations

import html
from collections.abc import Iterable

from rx90_common.exchange.arm_watch import NodeStatus
from rx90_emulator.view.live.source import LiveSource
from rx90_emulator.view.state import ArmState

_COLORS = ("#2b8a3e", "#e67700", "#c92a2a", "#868e96")  # good, warning, error, stale
_SIMULATION, _CONTROLLER = "brakes", "enabled"  # values that only this node has
_CELL = "padding:1px 0.6em 1px 0"


def status_html(source: LiveSource, state: ArmState | None, error: str, now: float) -> str:
    """Return a table: what is connected, time and pace, brakes, controller, trajectory, path error.

    Args:
        source: of the nodes.
        state: the newest; None before the first.
        error: path error in words.
        now: the steady clock's time, s.
    """
    problem = source.problem(now)
    if state is None or problem:
        return _table([("", _colored(problem, 1))])
    simulation, controller = source.node(_SIMULATION), source.node(_CONTROLLER)
    rows = [
        ("simulation", _word(simulation)),
        ("time", f"{state.time:.2f} s, {source.pace(now):.2f} &times; real time"),
        ("brakes", html.escape(simulation.values[_SIMULATION]) if simulation else "unknown"),
        ("controller", _word(controller)),
        ("trajectory", _trajectory(source, state)),
        ("path error", error),
    ]
    return _table(rows)


def diagnostics_html(nodes: dict[str, NodeStatus]) -> str:
    """Return all that the nodes have said of themselves."""
    if not nodes:
        return _table([("", "nothing on /diagnostics yet")])
    parts = []
    for name, status in sorted(nodes.items()):
        values = [(html.escape(key), html.escape(value)) for key, value in status.values.items()]
        parts.append(f"<b>{html.escape(name)}</b>: {_word(status)}{_table(values)}")
    return "".join(f'<div style="padding:0.2em 0.6em;font-size:0.8em">{part}</div>' for part in parts)


def _table(rows: Iterable[tuple[str, str]]) -> str:
    cells = "".join(
        f'<tr><td style="{_CELL};color:#868e96;white-space:nowrap;vertical-align:top">{name}</td>'
        f'<td style="{_CELL}">{value}</td></tr>'
        for name, value in rows
    )
    return f'<table style="font-size:0.85em;padding:0.2em 0.6em;border-spacing:0">{cells}</table>'


def _word(status: NodeStatus | None) -> str:
    return "not heard yet" if status is None else _colored(status.message, status.level)


def _colored(text: str, level: int) -> str:
    color = _COLORS[min(level, len(_COLORS) - 1)]
    return f'<span style="color:{color};font-weight:600">{html.escape(text)}</span>'


def _trajectory(source: LiveSource, state: ArmState) -> str:
    span = source.watch.trajectory
    if span is None or state.time > span.end:
        return "none"
    if state.time < span.begin:
        return f"begins in {span.begin - state.time:.1f} s"
    return f"{state.time - span.begin:.1f} of {span.end - span.begin:.1f} s"
