"""Types of messages: as rosbags knows them, and as the installed ROS packages have them."""

from __future__ import annotations

import importlib
import re
from functools import cache
from pathlib import Path
from typing import Any

from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from rx90_common.base.errors import BagError
from rx90_common.process.requirements import missing_module


@cache
def typestore(known: Stores = Stores.ROS2_JAZZY) -> Typestore:
    """Return the message types of ROS 2 Jazzy's common interfaces, or of others."""
    return get_typestore(known)


def message_class(topic: str, msgtype: str) -> Any:
    """Return the class of a message type."""
    package, _, name = msgtype.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except ImportError as error:
        raise BagError(f"{topic} has type {msgtype}: {missing_module(error) or error}") from error
    except AttributeError as error:
        raise BagError(
            f"{topic} has type {msgtype}, which the {package} that is installed does not have"
        ) from error


def types_with(msgtype: str, known: Stores = Stores.ROS2_JAZZY) -> Typestore:
    """Return known types, and with them a type and its parts, as its package defines them.

    Raises:
        BagError: if an installed package has no such definition.
    """
    types = get_typestore(known)
    added: Typesdict = {}
    wanted = [msgtype]
    while wanted:
        name = wanted.pop()
        if name not in types.fielddefs and name not in added:
            added |= get_types_from_msg(_definition(name), name)
            wanted += re.findall(r"\w+/msg/\w+", str(added[name]))  # its parts
    types.register(added)
    return types


def _definition(msgtype: str) -> str:
    """Return the text of a type's .msg file, which lies in the `share` folder beside the package's classes."""
    package, folder, name = msgtype.split("/")
    place = Path("share", package, folder, f"{name}.msg")
    for parent in Path(str(importlib.import_module(package).__file__)).parents:
        if (parent / place).exists():
            return (parent / place).read_text(encoding="utf-8")
    raise BagError(f"{msgtype}: the package that is installed has no {place}")
