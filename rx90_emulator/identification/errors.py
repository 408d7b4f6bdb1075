"""What can go wrong when friction is identified from bags."""

from __future__ import annotations

from rx90_common.base.errors import Rx90Error


class IdentificationError(Rx90Error):
    """The data, or what is said about them, do not allow the identification."""
