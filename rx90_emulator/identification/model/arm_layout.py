"""What the messages of an arm's logs hold, by options of a command or by a signal map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, TypeAlias, TypeVar

import numpy as np

from rx90_common.bags.mapping import MESSAGE_KEYS, LogMapping, is_table, mapping_of
from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, IdentificationError
from rx90_common.base.quoting import plain
from rx90_common.description.wrist import coupling_matrix
from rx90_common.exchange.topics import MOTOR_NAMES, MOTOR_STATES
from rx90_emulator.identification.model.options import MeasuredLayout, RobotOptions
from rx90_emulator.identification.records.layout import BagLayout

MessageOptions: TypeAlias = RobotOptions | MeasuredLayout
Options = TypeVar("Options", RobotOptions, MeasuredLayout)
NO_OPTIONS: Final = MeasuredLayout()


def with_signals(options: Options, logs: Sequence[Path]) -> tuple[Options, LogMapping | None]:
    """Return options with what a signal map says of the messages, and the map if the options name one.

    Args:
        options: of a command.
        logs: bags and tables; where the options name no map, that beside a table says so, too.

    Raises:
        ConfigError: for a map that is not acceptable, one key in a map and among the options, and tables whose maps
            say different things of the arm.
        BagError: for a table without a map.
    """
    given = None if options.signals is None else LogMapping.load(Path(options.signals))
    maps = [mapping_of(log) for log in logs if is_table(log)] if given is None else [given]
    for one in maps[1:]:
        if one.messages != maps[0].messages:
            raise ConfigError(
                f"{plain(one.file)} says other things of the arm than {plain(maps[0].file)}; accepted: the same "
                f"{', '.join(MESSAGE_KEYS)}"
            )
    said = maps[0].messages if maps else {}
    for key in said:
        if getattr(options, key) not in (None, False):
            raise ConfigError(f"--{key.replace('_', '-')} beside {key} in {plain(maps[0].file)}; accepted: one of them")
    return replace(options, **said), given


def arm_layout(
    topic: str,
    joints: Sequence[str],
    options: MessageOptions,
    own_gear: Callable[[], Array],
    mapping: LogMapping | None = None,
) -> BagLayout:
    """Return the layout of a topic of an arm of this project's structure.

    Args:
        topic: topic name; that of motors has this project's names and gears where the options say nothing else.
        joints: the joints' names.
        options: what the messages hold where it is not as here.
        own_gear: returns the robot's gears.
        mapping: what the columns of a table hold.

    Raises:
        IdentificationError: for options of another size, and a coupling without gears.
    """
    n = len(joints)
    for name, size in (("names", n), ("gear", n), ("torque_constant", n), ("zero", n), ("coupling", n * n)):
        values = getattr(options, name)
        if values is not None and len(values) != size:
            raise IdentificationError(f"--{name.replace('_', '-')}: {len(values)} values; accepted: {size}")
    motors = topic.rpartition("/")[2] == MOTOR_STATES
    gear = own_gear() if motors and options.gear is None else _array(options.gear)
    if gear is None and options.coupling is not None:
        raise IdentificationError("--coupling without --gear; accepted: for the motors' states, with their --gear")
    coupling = coupling_matrix() if options.coupling is None else np.reshape(options.coupling, (n, n))
    messages = options.names or (MOTOR_NAMES if motors else joints)
    layout = BagLayout.of(topic, messages, joints, gear, coupling, _array(options.torque_constant))
    return replace(layout, record_time=options.record_time, zero=_array(options.zero), mapping=mapping)


def _array(values: Sequence[float] | None) -> Array | None:
    return None if values is None else np.array(values, dtype=np.float64)
