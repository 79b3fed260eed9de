"""Recordings of real Grbl in a folder, and the simulated machine for each."""

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ..boardfile.files import load_board
from .compare import Json

# Files recorded from a Grbl with build options, and the simulator board with the same options.
_BOARDS = {
    "corexy": "sim_corexy",
    "force_set_origin_and_single_axis_homing": "sim_single_axis_homing",
    "line_numbers_and_mist": "sim_line_numbers",
    "max_step_rate_and_echo": "sim_echo",
    "punch": "sim_punch",
    "punch_09": "sim_punch_09",
    "rotary": "sim_rotary",
    "parking_and_override_control": "sim_parking",
    "safety_door_input": "sim_door",
    "spindle_enable_pin_and_two_switches": "sim_two_switches",
}
# The boards that answer as each Grbl does, for files without options.
_SPEAKERS = {"0.9i": "sim_09i", "0.9j": "sim_09j", "1.1": "sim"}
# The welcome, and the version in $I.
_VERSION = re.compile(r"Grbl (\d\.\d\w?) \[|\[(?:VER:)?(\d\.\d\w?)\.\d{8}:")


@dataclass
class Recording:
    """Cases of a file, and the board that they are replayed on."""

    category: str
    board: str
    cases: list[Json]


def load(folder: Path, only: str | None, board: str | None) -> list[Recording]:
    """Return the recordings in the files of a folder: a file is a category, and all motion records
    are one.

    only: one category; None: all. board: replaces the board that the recordings need. ValueError
    if a file is not a recording, or is of a Grbl whose dialect no board has.
    """
    files = [(path.stem, path) for path in sorted(folder.glob("*.json"))]
    files += [("motion", path) for path in sorted(folder.glob("motion/*.json"))]
    all_files = [(category, path, _cases(path)) for category, path in files]
    with_cases = [
        (category, path, cases) for category, path, cases in all_files if _has_cases(cases)
    ]
    dialects = _dialects(case for _, _, cases in with_cases for case in cases)
    recordings = [
        Recording(category, board or _board(path, cases, dialects), cases)
        for category, path, cases in with_cases
        if only in (None, category)
    ]
    if not recordings:
        raise ValueError(f"no recordings{f' of {only}' if only else ''} in {folder}")
    return recordings


def _cases(path: Path) -> list[Json]:
    """Return the cases of a file: a list of them, or one. ValueError if it is not JSON."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is no recording in JSON: remove it from the folder") from error
    return content if isinstance(content, list) else [content]


def _has_cases(cases: list[Json]) -> bool:
    """Return whether these are cases of conversations, or motion records."""
    return all(isinstance(case, dict) and ("steps" in case or "program" in case) for case in cases)


def _dialects(cases: Iterable[Json]) -> set[str]:
    """Return the versions of Grbl in the recorded replies: 0.9i, 0.9j, 1.1."""
    found: set[str] = set()
    for case in cases:
        for step in case.get("steps", ()):
            for match in _VERSION.finditer("\n".join(step["expect"])):
                version = match[1] or match[2]
                found.add("1.1" if version.startswith("1.1") else version)
    return found


def _board(path: Path, cases: list[Json], of_folder: set[str]) -> str:
    """Return the board whose dialect and options a file was recorded with.

    of_folder: the Grbl versions in the file's folder. A file in which no Grbl reports its version
    has that of its folder, or 1.1 if there are several.
    """
    dialects = _dialects(cases) or (of_folder if len(of_folder) == 1 else {"1.1"})
    if len(dialects) > 1:
        raise ValueError(
            f"{path} mixes recordings of several Grbl versions: {', '.join(sorted(dialects))}"
        )
    dialect = next(iter(dialects))
    if dialect not in _SPEAKERS:
        raise ValueError(f"{path} is of Grbl {dialect}, which ugrbl cannot imitate")
    name = _BOARDS.get(path.stem, _SPEAKERS[dialect])
    board_dialect = getattr(load_board(name), "DIALECT", "1.1")
    # A file of that name may be of another Grbl version than the board that has its options.
    return name if dialect.startswith(board_dialect) else _SPEAKERS[dialect]
