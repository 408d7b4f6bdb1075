"""What can go wrong between a person, a rig and an estimate; each text is one line meant for the user."""

from __future__ import annotations

from rx90_common.base.errors import Rx90Error


class RigError(Rx90Error):
    """The rig or the line to it does not do what it should."""


class RigLostError(RigError):
    """The line is gone: unplugged, taken by another program, or silent."""


class RigResetError(RigError):
    """The rig restarted by itself; it has to be greeted and armed again."""


class RigRefusedError(RigError):
    """The firmware refused a command."""


class RigFaultError(RigError):
    """The firmware latched a fault and took the torque away."""


class RecordError(Rx90Error):
    """A file does not hold a ramp test that can be read."""
