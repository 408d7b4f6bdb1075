"""All instructions and functions of the language: importing this module enters them in the registry."""

from rx90_emulator.vplus import arithmetic, control, hand_and_signals, locations, moves, output, text

MODULES = (arithmetic, control, hand_and_signals, locations, moves, output, text)
