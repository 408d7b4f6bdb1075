"""What can go wrong between a person, a rig and an estimate; each text is one line meant for the user."""

from __future__ import annotations

from rx90_common.base.errors import REFUSED, FailureError, Rx90Error


class RigError(FailureError):
    """The rig or the line to it does not do what it should."""


class RigLostError(RigError):
    """The line is gone: unplugged, taken by another program, or silent."""


class RigResetError(RigError):
    """The rig restarted by itself; it has to be greeted and armed again."""


class RigRefusedError(RigError):
    """The firmware refused a command."""


class RigFaultError(RigError):
    """The firmware latched a fault and took the torque away."""


class RigInputError(RigError):
    """A setting or a file asks for what this rig cannot do."""

    exit_code = REFUSED


class RecordError(Rx90Error):
    """A file does not hold a ramp test that can be used, or the folder does not take one."""
