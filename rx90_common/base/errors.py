"""The errors a user can meet; each message names the offending value and what is accepted."""

from __future__ import annotations


class Rx90Error(Exception):
    """Root of all errors of this project; its text is one line meant for the user."""


class ConfigError(Rx90Error):
    """A parameter or a configuration file is not acceptable."""


class DivergenceError(Rx90Error):
    """The plant's state left the range in which the model means anything."""


class TrajectoryError(Rx90Error):
    """A trajectory is refused; the text names joint, index and reason."""


class LineError(Rx90Error):
    """A Cartesian line cannot be travelled; the text says where on the line."""


class ExchangeError(Rx90Error):
    """Two nodes do not speak the same exchange (names, sizes, rates)."""


class MessageError(ExchangeError):
    """One message cannot be used; the next one may be."""


class BagError(Rx90Error):
    """A bag cannot be written, read or compared."""
