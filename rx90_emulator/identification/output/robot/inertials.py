"""Put <inertial> elements into a URDF and leave every other byte of it as it is."""

from __future__ import annotations

from collections.abc import Mapping
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import plain
from rx90_emulator.identification.excitation.bodies import central

_HEAVIEST = 1e5  # kg
_FARTHEST = 100.0  # m from the link's frame to its centre of mass
_MOMENTS = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}


def with_inertials(urdf: str, bodies: Mapping[str, Array | None], remark: str) -> str:
    """Return the URDF with other inertials.

    Args:
        urdf: a well-formed description.
        bodies: by links, the pseudo-inertia in the frame of the link, shape (4, 4), or None for no <inertial>.
        remark: a comment to put before the first element.

    Raises:
        IdentificationError: for a link that is not there, and for a body that no link can be.
    """
    data = urdf.encode("utf-8")
    places = _Places(data)
    edits = [(places.first, places.first, f"<!-- {remark.strip().replace('--', '- -')} -->\n  ".encode())]
    for link, pseudo in bodies.items():
        if link not in places.links:
            raise IdentificationError(f"no link {plain(link)} in the URDF; accepted: {', '.join(places.links)}")
        text = "" if pseudo is None else _inertial(link, pseudo)
        edits.append(places.edit(link, text))
    for start, end, new in sorted(edits, reverse=True):
        data = data[:start] + new + data[end:]
    return data.decode("utf-8")


def _inertial(link: str, pseudo: Array) -> str:
    """Return the element, its numbers to the last bit: what is loaded is what was identified."""
    mass, center, inertia = central(pseudo)
    if not (np.isfinite(pseudo).all() and 0.0 < mass < _HEAVIEST and np.linalg.norm(center) < _FARTHEST):
        raise IdentificationError(
            f"link {plain(link)} would have a mass of {mass:.3g} kg at {np.linalg.norm(center):.3g} m; accepted: up to "
            f"{_HEAVIEST:g} kg and {_FARTHEST:g} m"
        )
    place = " ".join(repr(float(value)) for value in center)
    moments = " ".join(f"{key}={quoteattr(repr(float(inertia[index])))}" for key, index in _MOMENTS.items())
    return (
        f'<inertial>\n      <origin xyz="{place}" rpy="0 0 0"/>\n      <mass value="{mass!r}"/>\n'
        f"      <inertia {moments}/>\n    </inertial>"
    )


class _Places:
    """Where in the bytes of a URDF the links and their inertials stand.

    Attributes:
        first: beginning of the first element inside the root.
        links: beginning of what follows the content of each link: its end tag, or what follows an empty element.
        inertials: beginning and end of the <inertial> of the links that have one.
    """

    def __init__(self, data: bytes) -> None:
        self.first = 0
        self.links: dict[str, int] = {}
        self.inertials: dict[str, tuple[int, int]] = {}
        self._data, self._path, self._link, self._begun = data, [""], "", 0
        self._parser = expat.ParserCreate("utf-8")
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.Parse(data, True)

    def edit(self, link: str, text: str) -> tuple[int, int, bytes]:
        """Return beginning, end and new content of the bytes that give a link this <inertial>, or none."""
        at = self.links[link]
        if link in self.inertials:
            return (*self.inertials[link], text.encode())
        if not text:
            return at, at, b""
        if self._data[at - 2 : at] == b"/>" and not self._data[at:].startswith(b"</link"):
            return at - 2, at, f">\n    {text}\n  </link>".encode()
        return at, at, f"  {text}\n  ".encode()

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        at = self._parser.CurrentByteIndex
        if len(self._path) == 2 and not self.first:
            self.first = at
        self._path.append(name)
        if self._path[2:] == ["link"]:
            self._link = attributes.get("name", "")
        if self._path[2:] == ["link", "inertial"]:
            self._begun = at

    def _end(self, name: str) -> None:
        at = self._parser.CurrentByteIndex
        if self._path[2:] == ["link"]:
            self.links[self._link] = at
        if self._path[2:] == ["link", "inertial"]:
            # Expat tells the beginning of an end tag, and the end of an empty element.
            tag = self._data[at:].startswith(f"</{name}".encode())
            self.inertials[self._link] = (self._begun, self._data.index(b">", at) + 1 if tag else at)
        self._path.pop()
