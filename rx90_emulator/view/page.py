"""The page: a server on this machine, tabs for parts, and the one thread on which they work."""

from __future__ import annotations

import heapq
import ipaddress
import itertools
import logging
import os
import queue
import socket
import threading
import time
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from functools import partial

import numpy as np
import rich
import viser

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import quoted
from rx90_common.description.robot import RobotModel

TO_OTHERS = (
    "other machines can open the page, too: they see the arm, and who has the code can move it; who listens on the "
    "way can read the code"
)
"""What is said of a page that other machines reach."""
_LONGEST_WAIT = 0.05  # s, without a look for Ctrl-C
_BUSY_FACTOR = 3  # how much longer periods are while a part is busy
_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")
_EYE = np.array([1.35, -1.15, 0.6])  # from the arm's centre, in lengths of the arm
_CENTER = np.array([0.25, 0.0, 0.4])
_FIELD_OF_VIEW = 0.75  # rad, upright
_PANEL_WIDTH = 310  # pixels


class _Server(viser.ViserServer):
    """Viser's server, without the tunnel through another machine that any client can ask it for."""

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002 - viser's signature
        """Make no tunnel."""
        return None


class Page:
    """A page in the browser, served until `close`.

    Args:
        title: above the control panel.
        host: address to bind to; 127.0.0.1 is reached from this machine alone.
        port: to bind to; 0 takes a free one.

    Attributes:
        server, gui, scene: viser's own.
        tab: adds a tab with a label to the control panel, to be filled in a `with` block.
        add_lines: adds line segments to the scene, float32 (n, 2, 3) m, as thick in pixels wherever the camera is.
        address: what to open in a browser.
    """

    def __init__(self, title: str, host: str = "127.0.0.1", port: int = 8080) -> None:
        self._open_to_others = _is_open_to_others(host, port)
        rich.get_console().quiet = (
            True  # viser draws a box with addresses, and tells of each connection
        )
        # Somebody closed a connection before it was one: a tab that was closed early, a scan of ports. Viser leaves
        # that out, too, but only from the first request on.
        logging.getLogger("websockets.server").addFilter(
            lambda said: said.getMessage() != "opening handshake failed"
        )
        self.server = _Server(host=host, port=port, label=title, verbose=False)
        self.gui = self.server.gui
        self.scene = self.server.scene
        shown = f"[{host}]" if ":" in host else host
        self.address = f"http://{shown}:{self.server.get_port()}/"
        self.gui.configure_theme(show_logo=False, show_share_button=False)
        self.gui.main_panel.dock_right()
        self.gui.main_panel.set_width(_PANEL_WIDTH)
        self.tab = self.gui.add_tab_group().add_tab
        self.add_lines = partial(self.scene.add_line_segments, thickness_units="screen")
        # No SimpleQueue: its wait has no end where a signal is handled until after the time-out.
        self._handed_over: queue.Queue[Callable[[], None]] = queue.Queue()
        # When the next call is due, a number by which calls of one time are in order, and what `every` was given.
        self._timed: list[
            tuple[float, int, float, Callable[[float], None], Callable[[float], bool]]
        ] = []
        self._numbers = itertools.count()
        self.scene.set_up_direction("+z")
        self.scene.world_axes.visible = False
        self.scene.add_grid(
            "/floor", 2.4, 2.4, cell_size=0.1, section_size=0.5, position=(0.0, 0.0, -0.001)
        )
        # The usual environment takes the colours away.
        self.scene.configure_environment_map("studio", environment_intensity=0.35)

    def look_at_arm(self, robot: RobotModel) -> None:
        """Place the camera of pages that are opened from now on, so that the whole arm is seen."""
        reach = float(np.linalg.norm(robot.chain.origin, axis=1).sum())
        camera = self.server.initial_camera
        center = _CENTER * reach
        camera.position = center + _EYE * reach
        camera.look_at = center
        camera.fov = _FIELD_OF_VIEW

    def every(
        self,
        period: float,
        function: Callable[[float], None],
        busy: Callable[[float], bool] = lambda _: False,
    ) -> None:
        """Call `function(now)` every `period` s while the page runs, on its thread; late calls are left out.

        While `busy(now)` holds it is called a third as often.
        """
        heapq.heappush(self._timed, (time.monotonic(), next(self._numbers), period, function, busy))

    def later(self, function: Callable[[], None]) -> None:
        """Call `function()` once on the page's thread; from any thread."""
        self._handed_over.put(function)

    def announce(self, *, browser: bool) -> None:
        """Print the address, and open it in a browser if there is a screen."""
        if self._open_to_others:
            print(TO_OTHERS, flush=True)
        print(f"page: {self.address} (Ctrl-C ends it)", flush=True)
        if browser and any(os.environ.get(name) for name in _SCREENS):
            # Some browsers are waited for until they end.
            threading.Thread(
                target=webbrowser.open, args=[self.address], name="browser", daemon=True
            ).start()

    def run(
        self,
        check_interrupt: Callable[[], None],
        until: Callable[[], bool] = lambda: False,
    ) -> None:
        """Run the parts until `until()` holds.

        Args:
            check_interrupt: called between two calls; raises what has interrupted them.
            until: asked between two calls.
        """
        while not until():
            check_interrupt()
            now = time.monotonic()
            wait = _LONGEST_WAIT
            if self._timed:
                due, _, period, function, busy = self._timed[0]
                wait = min(wait, max(0.0, due - now))
                if due <= now:
                    due = max(due + period * (_BUSY_FACTOR if busy(now) else 1), now)
                    heapq.heapreplace(
                        self._timed, (due, next(self._numbers), period, function, busy)
                    )
                    self._call(partial(function, now))
            with suppress(queue.Empty):
                self._call(self._handed_over.get(timeout=wait))

    def _call(self, function: Callable[[], None]) -> None:
        """Call a part, whose changes the page shows together."""
        try:
            with self.server.atomic():
                function()
        except RuntimeError as error:
            # Viser wakes those who wait for its messages from this thread, too, and may meet its own thread there. What
            # was changed is shown all the same, and the rest with the next call.
            if "deque mutated" not in str(error):
                raise

    def close(self) -> None:
        """Stop the server."""
        self.server.stop()


def block(content: str) -> str:
    """Return HTML as the panel shows text: small, and broken where it is too wide."""
    return f'<div style="padding:0 0.6em;font-size:0.8em;overflow-wrap:anywhere">{content}</div>'


def _is_open_to_others(host: str, port: int) -> bool:
    """Bind to host and port once, and let go: viser would take another port, or wait for ever; tell who reaches it."""
    try:
        family, _, _, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ConfigError(
            f"--host {quoted(host)}: {reason}; accepted: an address of this machine"
        ) from error
    try:
        with socket.create_server(place, family=family) as bound:
            address = str(bound.getsockname()[0])
    except OSError as error:
        reason = os.strerror(error.errno or 0)
        accepted = "--port with a free one, or 0 for any, and an address of this machine"
        raise ConfigError(f"{host} port {port}: {reason}; accepted: {accepted}") from error
    return not ipaddress.ip_address(address.partition("%")[0]).is_loopback
