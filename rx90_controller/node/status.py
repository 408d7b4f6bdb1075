"""What the controller node's diagnostics say."""

from __future__ import annotations

import time

from diagnostic_msgs.msg import DiagnosticStatus

from rx90_common.exchange.pacing import Pacer
from rx90_common.exchange.topics import FREE_RUNNING
from rx90_controller.law.cs7b import CS7B
from rx90_controller.node.serving import Serving
from rx90_controller.node.servo_loop import ServoLoop


class ControllerStatus:
    """How law, loops and ticks go; asked once a second by the executor's thread."""

    def __init__(self, cs7b: CS7B, loop: ServoLoop, serving: Serving, pacer: Pacer) -> None:
        self._cs7b, self._loop, self._serving, self._pacer = cs7b, loop, serving, pacer
        self._reported = (0, time.monotonic())  # tick and time of the last one

    def collect(self) -> tuple[bytes, str, dict[str, str]]:
        """Return the level, the message and the values, as `Diagnostics` asks for them."""
        cs7b, counts = self._cs7b, self._pacer.take()
        rates = cs7b.rates
        rejected, last_rejection = self._loop.rejections
        values = {
            "time mode": self._serving.mode or "unknown: no simulation yet",
            "controller time, s": f"{cs7b.tick * rates.period:.3f}",
            "rate, Hz": f"{self._rate():.1f}",
            "saturated ticks": " ".join(str(n) for n in cs7b.saturated),
            "rejected trajectories": str(rejected),
            "last rejection": last_rejection or "none",
            "enabled": "true" if self._loop.enabled else "false",
        }
        if self._serving.mode == FREE_RUNNING:
            values |= {
                "worst period, ms": f"{counts.worst * 1e3:.3f}",
                "late ticks": str(counts.late),
                "dropped ticks": str(counts.dropped),
            }
        fault = self._loop.fault
        if fault is not None:
            return DiagnosticStatus.ERROR, f"{fault}; torque off, brakes closed", values
        if not self._loop.running:
            return DiagnosticStatus.WARN, "waiting for the simulation", values
        if not self._loop.active:
            return DiagnosticStatus.OK, "inactive", values
        moving = cs7b.trajectory.moving(cs7b.position_tick)
        return DiagnosticStatus.OK, "following a trajectory" if moving else "holding", values

    def _rate(self) -> float:
        """Return the ticks per second since the last call; 0 over a reset."""
        (tick, at), self._reported = self._reported, (self._cs7b.tick, time.monotonic())
        now_tick, now = self._reported
        return max(0.0, (now_tick - tick) / (now - at))
