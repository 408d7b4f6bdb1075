"""What can go wrong with a rig and the line to it; each text is one line meant for the user."""

from __future__ import annotations

from rx90_common.base.errors import REFUSED, FailureError


class RigError(FailureError):
    """The rig or the line to it does not do what it should."""


class RigLostError(RigError):
    """The line is gone: unplugged, held by another program, or silent."""


class RigResetError(RigError):
    """The rig restarted by itself; it has to be greeted and armed again."""


class RigRefusedError(RigError):
    """The firmware refused a command."""


class RigFaultError(RigError):
    """The firmware latched a fault and took the torque away."""


class RigInputError(RigError):
    """A setting or a file asks for what this rig cannot do."""

    exit_code = REFUSED
