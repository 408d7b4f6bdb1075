"""What can go wrong with a sweep as a whole, as against a single run of it."""

from __future__ import annotations

from rx90_common.base.errors import Rx90Error


class SweepError(Rx90Error):
    """A sweep cannot start, go on or be read."""
