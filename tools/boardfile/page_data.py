"""Provide the tables from which the page makes board files, as JSON.

tools/web/page/board_file.js repeats the rules themselves. host_tests/web/test_board_rules.py
compares both with random boards.
"""

from typing import Any

from .. import __version__, paths
from . import board_check, new_board
from .chips import CHIPS
from .engines import WIRELESS, engines
from .files import boards, load
from .modules import module
from .options import BY_NAME, INVERTIBLE, NAMES, WORD, Option

# The options in the forms. The rules of the others need modules that a page cannot read, or pins
# of an engine; their lines in a board file of boards/ are kept unchanged.
FORMS = {
    "Motors": (
        *("COREXY", "BACKLASH", "SKEW", "JERK", "ARC_ACCELERATION"),
        *("DIR_SETUP_US", "DIR_HOLD_US"),
        *("MAX_STEP_RATE_HZ", "STEP_PULSE_MIN_US"),
    ),
    "Homing and inputs": (
        *("HOMING", "SINGLE_AXIS_HOMING", "FORCE_SET_ORIGIN", "DUAL_LIMIT_SWITCHES"),
        *("LIMIT_DEBOUNCE_MS", "CONTROL_DEBOUNCE_MS", "PARKING", "OVERRIDE_CONTROL"),
    ),
    "Tool": ("TOOL", "PWM_HZ", "PWM_MAX", "SPINDLE_ENABLE_PIN", "INVERT", "CLUSTERS"),
    "Network and jobs": ("LINK", "PAGE", "JOBS"),
    "Language": ("DIALECT", "LENIENT", "LINE_NUMBERS", "ECHO", "COUNT_DRAINS"),
    "Memory and safety": ("PLANNER_BLOCKS", "RX_BYTES", "LOOP_MS", "WATCHDOG_MS"),
}
# A punch needs its own pins: docs/punch.md.
_LEFT_OUT = {"TOOL": ("punch",)}


def data() -> dict[str, Any]:
    """Return all data, with types of JSON only; board_file.js reads these names."""
    return {
        "version": __version__,
        "chips": {name: _chip(name) for name in CHIPS},
        "items": [list(item) for item in new_board.ITEMS],
        "quick": new_board.FAST_PINS,
        "controls": new_board.CONTROLS,
        "switchedOn": new_board.SWITCHED_ON,
        "wireless": WIRELESS,
        "invertible": INVERTIBLE,
        "noPage": new_board.NO_PAGE,
        "tooSmall": new_board.TOO_SMALL,
        "rmtHz": engines()["rmt"].most_hz,
        "mostBesideBeam": board_check.MOST_MOTORS_WITH_LASER,
        "apart": _excluded(),
        "forms": {
            title: [_option(BY_NAME[name]) for name in names] for title, names in FORMS.items()
        },
        "order": list(BY_NAME),
        "boards": {name: _board(name) for name in boards() if not name.startswith("sim")},
    }


def _chip(name: str) -> dict[str, Any]:
    """Return a row of CHIPS with its drawing."""
    chip = CHIPS[name]
    return {
        **chip._asdict(),
        "pins": sorted(chip.pins),
        "inputs_only": sorted(chip.inputs_only),
        "odd": {str(pin): words for pin, words in chip.odd.items()},
        "module": module(name)._asdict(),
    }


def _option(option: Option) -> dict[str, Any]:
    """Return an option for a form. words: values that it may have; choices: those to be shown."""
    words = list(option.words()) if option.words and option.kind in (WORD, NAMES) else None
    left_out = _LEFT_OUT.get(option.name, ())
    return {
        "name": option.name,
        "kind": option.kind.title,
        "default": option.default,
        "meaning": option.meaning,
        "low": option.low,
        "high": option.high,
        "words": words,
        "choices": words and [word for word in words if word not in left_out],
    }


def _excluded() -> dict[str, tuple[str, ...]]:
    """Return, by an option, those that it excludes; from the extras, in their order."""
    paths.use_firmware()
    from extras.kinematics import skew
    from extras.motors import backlash

    return {extra.EXCLUDED[0]: extra.EXCLUDED[1:] for extra in (backlash, skew)}


def _board(name: str) -> dict[str, Any]:
    """Return a board file: its text, its values, and its chip."""
    file = paths.BOARDS / f"{name}.py"
    module_of_board = load(file)
    values = {word: value for word, value in vars(module_of_board).items() if word.isupper()}
    chip = next(one for one in CHIPS if CHIPS[one] in board_check.chips_of(module_of_board))
    about = (module_of_board.__doc__ or "").strip().partition("\n")[0]
    return {
        "about": about,
        "chip": chip,
        "values": values,
        "text": file.read_text(encoding="utf-8"),
    }
