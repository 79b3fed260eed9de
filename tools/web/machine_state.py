"""Set up the simulated machine before a program: position, offsets and modes known to the page.

For X, Y and Z; mm, machine coordinates. Invalid values are ignored, because the result is only a
preview, and a machine may report words that the simulated one does not know.
"""

import re
from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

import numpy as np

from ..draw.motion_trace import LETTERS, Motion

_SYSTEMS = ("G54", "G55", "G56", "G57", "G58", "G59")
_STORED = ("G28", "G30")  # stored positions, not coordinate systems
# Motion, plane, units, distance and feed modes; a feed rate.
_MODE = re.compile(r"G(?:[0-3]|80|1[7-9]|2[01]|9[0134])")
_FEED = re.compile(r"F\d{1,6}(?:\.\d{1,3})?")
_AXES = 3
_FARTHEST_MM = 1e5
_TOLERANCE_MM = 0.005  # smaller differences are the rounding of steps
# Numbers of settings; _TRAVEL is that of X.
_SOFT_LIMITS, _HOMING_DIRECTIONS, _TRAVEL = 20, 23, 130

Place = tuple[float, ...]


def lines(request: Mapping[str, Any]) -> list[str]:
    """Return lines that bring a fresh machine to the state in a request.

    "place": machine coordinates. "offsets": lists by name, those of `$#`: of G54 to G59, G92 and
    the tool length TLO, and the positions G28 and G30. "modes": words as of `$G`.
    """
    offsets = _offsets(request.get("offsets"))
    modes = [word for word in _list_of(request.get("modes")) if isinstance(word, str)]
    system = next((word for word in modes if word in _SYSTEMS), _SYSTEMS[0])
    place = _position_of(request.get("place")) or (0.0,) * _AXES
    commands = []
    for name in _STORED:
        if name in offsets:  # G28.1 stores the position at which the machine is
            commands += [_move_to(offsets[name]), f"{name}.1"]
    for number, name in enumerate(_SYSTEMS, 1):
        if name in offsets:
            commands.append(f"G21 G10 L2 P{number} {_axis_words(offsets[name])}")
    commands += [_move_to(place), system]
    tool_mm = offsets.get("TLO", (0.0,))[0]
    if tool_mm:
        commands.append(f"G21 G43.1 Z{tool_mm:.4f}")
    if "G92" in offsets:
        g92 = _g92_coordinates(place, offsets.get(system), tool_mm, offsets["G92"])
        commands.append(f"G21 G92 {_axis_words(g92)}")
    commands += [f"G21 G94 {word}" for word in modes if _FEED.fullmatch(word)]
    # Last, because the other lines set modes, too.
    mode_words = [word for word in modes if _MODE.fullmatch(word)]
    return commands + ([" ".join(mode_words)] if mode_words else [])


def _move_to(place: Place) -> str:
    """Return a rapid move to machine coordinates in mm."""
    return f"G21 G90 G53 G0 {_axis_words(place)}"


def _axis_words(place: Place) -> str:
    """Return the words of a position: X1.0000 Y2.0000 Z3.0000."""
    return " ".join(f"{letter}{mm:.4f}" for letter, mm in zip(LETTERS, place, strict=False))


def _g92_coordinates(place: Place, system: Place | None, tool_mm: float, shift: Place) -> Place:
    """Return the coordinates to give G92 at `place`, in machine coordinates, so that its offset
    becomes `shift`. system: the offset of the active coordinate system, None: 0; tool_mm: the
    length offset, of Z."""
    offsets = system or (0.0,) * _AXES
    lengths = (0.0, 0.0, tool_mm)
    parts = zip(place, offsets, lengths, shift)
    return tuple(mm - offset - length - shift_mm for mm, offset, length, shift_mm in parts)


def _offsets(value: Any) -> dict[str, Place]:
    """Return the valid positions by name, without those that are 0."""
    if not isinstance(value, dict):
        return {}
    places = {name: _position_of(numbers) for name, numbers in value.items()}
    return {name: place for name, place in places.items() if place and any(place)}


def _position_of(value: Any) -> Place | None:
    """Return a list of a request as coordinates of the first _AXES axes, in mm; None if it is
    empty or invalid."""
    numbers = _list_of(value)[:_AXES]
    if not numbers or not all(isinstance(number, int | float) for number in numbers):
        return None
    place = tuple(float(number) for number in numbers)
    return place if all(isfinite(mm) and abs(mm) < _FARTHEST_MM for mm in place) else None


def _list_of(value: Any) -> Sequence[Any]:
    """Return a list of a request; () if it is none."""
    return value if isinstance(value, list) else ()


# The end of the travel


def beyond(
    motion: Motion, settings: Mapping[int, str], request: Mapping[str, Any]
) -> list[tuple[int, str]]:
    """Return where the soft limits ($20=1) would end a program.

    For each end of an axis: the first line beyond it, and its message. "options" of a request
    holds the letters of `[OPT:`.
    """
    if float(settings.get(_SOFT_LIMITS, 0)) != 1:
        return []
    # With FORCE_SET_ORIGIN (Z), an axis that homes at its lower end has positive coordinates.
    has_origin = "Z" in str(request.get("options", ""))
    # A mask of those axes.
    positive = int(float(settings.get(_HOMING_DIRECTIONS, 0))) if has_origin else 0
    problems = []
    for axis, column in enumerate(motion.place[:_AXES]):
        travel = float(settings.get(_TRAVEL + axis, 0))
        low, high = (0.0, travel) if positive >> axis & 1 else (-travel, 0.0)
        if travel > 0:
            places = np.frombuffer(column, np.float32)
            problems += _over(motion, places, high, axis)
            problems += _over(motion, -places, -low, axis, sign=-1)
    return sorted(problems)


def _over(
    motion: Motion, places: Any, end: float, axis: int, sign: int = 1
) -> list[tuple[int, str]]:
    """Return the first line beyond one end of an axis, and its message; [] if there is none.

    places: machine coordinates, mm, of each row of the motion. sign -1: the lower end, for which
    `places` and `end` are negated.
    """
    is_over = places > end + _TOLERANCE_MM
    is_of_program = motion.lines > 0
    rows = np.flatnonzero(is_over & is_of_program)
    if not len(rows):
        return []
    farthest = sign * float(places[rows].max())
    last = sign * end + 0.0  # + 0.0: no "-0" in the message
    return [
        (
            int(motion.lines[rows[0]]),
            f"ALARM:2 - {LETTERS[axis]} would go to {farthest:.3f} mm in machine coordinates, and "
            f"its travel ends at {last:g} (${_SOFT_LIMITS}, ${_TRAVEL + axis})",
        )
    ]
