"""A page in a real Chromium without a window, one for a session: what it draws, asks for and complains of."""

import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from needs import give_up, need

from tools.packages import CHROMIUM_NAMES

CHROMIUM = next(filter(None, map(shutil.which, CHROMIUM_NAMES)), None)  # Debian's, or another one on the path
TIMEOUT = 60_000  # ms; Chromium draws in software, on a machine with other things to do
# Nothing of its own goes to other machines, and WebGL works without a graphics card.
# All but WebGL is drawn without GL: in software that takes three times the processor time.
_FLAGS = (
    *("--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync", "--ignore-gpu-blocklist", "--use-gl=angle"),
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-gpu-rasterization", "--disable-accelerated-2d-canvas"),
)
_DESKTOP = (1000, 500)  # small: what is drawn in software takes time by the pixel
# What the page's software says of itself; nothing is wrong.
# The last one is said where the page tries, by a picture that `_SELDOM` leaves out, in which format it can read pixels.
_USUAL = (
    "THREE.Clock: This module has been deprecated",
    "GPU stall due to ReadPixels",
    "This browser does not support reading pixels from",
)
_MATRIX = "name => window.__viserMutable?.nodeRefFromName[name]?.matrixWorld.elements"
# Sixty frames a second would take a processor's time in software. Here there are five at most, of which most tests draw
# none: places and plots do not depend on it. "few" are the first ones, which show errors of drawing, then one in 4 s.
_SELDOM = """let picture = 0;
    window.requestAnimationFrame = draw => setTimeout(() => { picture++; draw(performance.now()); }, 200);
    window.cancelAnimationFrame = clearTimeout;
    for (const name of ['drawElements', 'drawArrays', 'drawElementsInstanced', 'drawArraysInstanced']) {
        const draw = WebGL2RenderingContext.prototype[name];
        WebGL2RenderingContext.prototype[name] = function (...rest) {
            if (%s) draw.apply(this, rest);
        };
    }"""
_DRAWN = {"none": "false", "few": "picture < 6 || picture % 20 === 0"}
_SHOWN = "() => Boolean(window.__viserMutable?.scene) && !document.body.innerText.includes('Connecting')"


class BrowserPage:
    def __init__(self, page: Any, address: str) -> None:
        self.page, self._address = page, address
        self.requests: list[str] = []
        self.complaints: list[str] = []
        page.set_default_timeout(TIMEOUT)
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("websocket", lambda socket: self.requests.append(socket.url))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("console", self._note)
        page.goto(address)
        page.wait_for_function(_SHOWN)

    def _note(self, message: Any) -> None:
        usual = any(text in message.text for text in _USUAL)
        if message.type in {"warning", "error"} and not usual:
            self.complaints.append(message.text)

    @property
    def foreign_requests(self) -> list[str]:
        own = urlsplit(self._address).netloc
        inside = ("data:", "blob:")
        return [url for url in self.requests if not url.startswith(inside) and urlsplit(url).netloc != own]

    def pose(self, node: str) -> np.ndarray:
        """Return the pose (4, 4) of a node of the scene, as it is drawn, in the frame of the scene's origin."""
        root, own = (self._matrix(name) for name in ("", node))
        return np.linalg.solve(root, own)

    def _matrix(self, node: str) -> np.ndarray:
        elements = self.page.wait_for_function(_MATRIX, arg=node).json_value()
        columns = elements.values() if isinstance(elements, dict) else elements
        return np.array(list(columns), dtype=np.float64).reshape(4, 4).T

    def button(self, name: str) -> Any:
        return self.page.get_by_role("button", name=name)

    def wait_until(self, ready: Callable[[], bool], what: str) -> None:
        for _ in range(TIMEOUT // 50):
            if ready():
                return
            self.page.wait_for_timeout(50)
        pytest.fail(f"waited {TIMEOUT / 1000:g} s in vain for {what}")

    def text(self) -> str:
        return str(self.page.inner_text("body"))


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """Start Chromium once; skip where it or playwright is missing, fail where packages are required."""
    need("chromium")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        give_up("playwright is not installed; accepted: pip install playwright")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=_FLAGS)
        try:
            yield browser
        finally:
            browser.close()


@pytest.fixture
def open_page(chromium: Any) -> Iterator[Callable[..., BrowserPage]]:
    opened = []

    def open_(address: str, size: tuple[int, int] = _DESKTOP, *, pictures: str = "none") -> BrowserPage:
        page = chromium.new_context(viewport={"width": size[0], "height": size[1]}).new_page()
        opened.append(page)
        if pictures != "every":
            page.add_init_script(_SELDOM % _DRAWN[pictures])
        return BrowserPage(page, address)

    yield open_
    for page in opened:
        page.context.close()


@contextmanager
def served(page: Any) -> Iterator[Any]:
    ended = threading.Event()
    thread = threading.Thread(target=page.run, args=(lambda: None, ended.is_set), daemon=True)
    thread.start()
    try:
        yield page
    finally:
        ended.set()
        thread.join(10.0)
        page.close()
