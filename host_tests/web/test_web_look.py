"""Test the previews of programs that `ugrbl web` makes.

A preview is the answer to a POST at /api/look: `seconds`, `problems` (line, error or alarm code,
text), `lines`, `times` (rows of line and seconds at its end) and `path` (rows of X, Y, Z in mm of
machine coordinates, kind (0 rapid, 1 feed), line, mean speed in mm/min). Settings have their
numbers as keys: 110 is the X rate, 130 to 132 the travel.

STANDING is the state of a machine, for a request: position (-50, -60, -5.5), offsets of G54 (-100,
-110, -30) and G55 (-10, -20, 0), G28 at (-5, -6, -7), G92 (1, 2, 3), tool length 4 mm, and modes.
@played makes a coroutine a plain function; served() runs a server at a board.
"""

import asyncio
from itertools import pairwise
from math import dist
from pathlib import Path
from typing import Any

import pytest
from ugrbl.run.program import run_program
from ugrbl.web.preview import MOST_POINTS, MOST_TIMES, PROGRAM_BYTES
from web_client import FakeBoard, played, served

pytestmark = [pytest.mark.xdist_group("web"), pytest.mark.thorough]

_SQUARE = "G21 G90\nG0 X10\nG1 Y10 F300\nX0\nY0\nM30\n"


def look(folder: Path, *requests: Any, longest_s: float = 60.0) -> "list[tuple[int, Any]]":
    """Post the requests one after the other; return status and answer of each."""
    answers = []

    @played
    async def ask() -> None:
        async with served(FakeBoard(), folder, longest_s=longest_s) as site:
            answers.extend([await site.look(request) for request in requests])
            assert not site.log

    ask()
    return answers


def test_time_path_and_lines_match_run(tmp_path: Path) -> None:
    """The preview has the same time as a run in the simulator.

    Line ends and mean speeds are checked against the program.
    """
    ((status, found),) = look(tmp_path, {"name": "square.nc", "program": _SQUARE})
    assert status == 200
    # The same program in the simulator.
    wanted, _ = run_program(_SQUARE.encode().splitlines())
    assert found["seconds"] == pytest.approx(wanted.totals.time_s, abs=0.001)
    assert (found["name"], found["lines"], found["problems"]) == ("square.nc", 6, [])
    segment_ends = {(x, y): (kind, line) for x, y, _, kind, line, _ in found["path"]}
    # (x, y): (kind, line).
    assert (
        segment_ends[10, 0] == (0, 2)
        and segment_ends[10, 10] == (1, 3)
        and segment_ends[0, 10] == (1, 4)
    )
    assert found["path"][-1][:5] == [0, 0, 0, 1, 5]
    of_line_3 = [(a, b) for a, b in pairwise(found["path"]) if b[4] == 3]
    # F300, and the rounding of a mean speed.
    assert all(0 < b[5] <= 301 for _, b in of_line_3)
    # Length in mm over speed in mm/min of each part of line 3.
    took_s = sum(60 * dist(a[:3], b[:3]) / b[5] for a, b in of_line_3)
    ends_s = dict(found["times"])
    assert took_s == pytest.approx(ends_s[3] - ends_s[2], rel=0.02), "speeds are means"
    # Lines 1 and 6 do not move.
    assert [line for line, _ in found["times"]] == [2, 3, 4, 5]
    assert found["times"][-1][1] == pytest.approx(found["seconds"], abs=0.05)


def previews_with_each(folder: Path, *settings: "dict[str, Any]") -> "list[Any]":
    """Return the preview of _SQUARE with the defaults, then with each of these settings."""
    requests = [{"program": _SQUARE, "settings": each} for each in ({}, *settings)]
    return [found for _, found in look(folder, *requests)]


def test_machine_settings_apply_as_texts_and_numbers(tmp_path: Path) -> None:
    # $999 does not exist and is ignored; $0 has no effect on the time.
    quick = {"110": "6000", "111": "6000.000", "120": 500, "121": "500", "999": "1", "0": "1"}
    plain, faster = previews_with_each(tmp_path, quick)
    assert faster["seconds"] < plain["seconds"] - 1


def test_invalid_machine_settings_are_ignored(tmp_path: Path) -> None:
    """A browser may send any JSON as settings; what is no valid setting changes nothing."""
    # By kind of fault; a JSON request can have any of them.
    no_numbers: dict[str, Any] = {"x": "1", "²": "1", "": "1", " 112": "1", "9" * 5000: "1"}
    no_values: dict[str, Any] = {"100": "many", "110": None, "120": [], "121": "nan"}
    beyond_single_precision: dict[str, Any] = {"101": "1e999", "102": 1e300}
    refused_or_unknown: dict[str, Any] = {"111": "-1", "999": "2e38"}
    invalid = {**no_numbers, **no_values, **beyond_single_precision, **refused_or_unknown}
    # The preview with the defaults, and with the invalid settings.
    plain, same = previews_with_each(tmp_path, invalid)
    assert same == plain


def test_settings_that_move_nothing_leave_the_preview_unchanged(tmp_path: Path) -> None:
    """Homing and soft limits ($22, $20) are left out; $13 is the reports' unit, $12 is of arcs."""
    settings: dict[str, Any] = {"22": "1", "20": "1", "12": "1e-9", "13": True}
    plain, same = previews_with_each(tmp_path, settings)
    assert same == plain


STANDING = {
    "place": [-50, -60, -5.5],
    "offsets": {
        "G54": [-100, -110, -30],
        "G55": [-10, -20, 0],
        "G28": [-5, -6, -7],
        "G92": [1, 2, 3],
        "TLO": [4],
    },
    "modes": "G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0".split(),
}


def ends(found: Any) -> "dict[int, list[float]]":
    """Return where the motion of each line ends."""
    return {line: [x, y, z] for x, y, z, _, line, _ in found["path"]}


def test_program_starts_at_machine_position_with_its_offsets(tmp_path: Path) -> None:
    """Work coordinates of the program become machine coordinates by the offsets in STANDING."""
    program = "G0 X10 Y0\nG0 Z1\nG55 X0 Y0\nG53 Z0\nG28\nG91 G0 X1\n"
    ((status, found),) = look(tmp_path, {"program": program, **STANDING})
    assert status == 200 and not found["problems"]
    assert found["path"][0][:3] == [-50, -60, -5.5]
    assert ends(found) == {
        # Machine coordinates: the offsets of G54 (-100, -110, -30) or G55 (-10, -20, 0), and of
        # G92 (1, 2, 3), are added, and the tool length 4 in Z. G53 and G28 ignore them.
        0: [-50, -60, -5.5],
        1: [-100 + 1 + 10, -110 + 2, -5.5],
        2: [-89, -108, -30 + 3 + 4 + 1],
        3: [-10 + 1, -20 + 2, -22],
        4: [-9, -18, 0],
        5: [-5, -6, -7],
        6: [-4, -6, -7],
    }


def test_time_counts_from_machine_position(tmp_path: Path) -> None:
    far = {"program": "G0 X0\n", "place": [-100, 0, 0]}
    (_, near), (_, found) = look(tmp_path, {**far, "place": [-10, 0, 0]}, far)
    assert found["seconds"] == pytest.approx(near["seconds"] + 90 / 500 * 60, abs=0.2)
    assert found["times"] == [[1, pytest.approx(found["seconds"], abs=0.05)]]


def test_active_modes_apply_to_program(tmp_path: Path) -> None:
    """The program inherits G1, G20 (inches), G91 (relative) and G55 from the machine."""
    modes = "G1 G55 G17 G20 G91 G94 M5 M9 T0 F600.5 S0".split()
    request = {"program": "X1\nX1\n", "modes": modes, "offsets": {"G55": [3, 3, 3]}}
    ((_, found),) = look(tmp_path, request)
    assert not found["problems"], "G1 with a feed"
    assert ends(found)[2][0] == pytest.approx(50.8, abs=0.005)  # 2 inch in mm
    assert max(row[5] for row in found["path"]) == pytest.approx(500, abs=1), "$110"


def test_invalid_machine_state_is_ignored(tmp_path: Path) -> None:
    """Invalid positions, offsets and modes give the same preview as none at all."""
    invalid_states: "list[dict[str, Any]]" = [
        {"place": "here", "offsets": [1], "modes": {}},
        {"place": [None], "offsets": {"G54": "x", "G99": [1], "": []}, "modes": [7, "G64", "!"]},
        {"place": [1e300], "offsets": {"G54": [float("nan")], "TLO": [], "G92": [[]]}},
        {"place": [], "offsets": {"G54": [1e6, 0, 0]}, "modes": ["F1e9", "G1\nG0 X9", "$X"]},
        {"options": 7, "modes": None, "place": None, "offsets": None},
    ]
    requests = [{"program": _SQUARE, **stands} for stands in ({}, *invalid_states)]
    (_, without_state), *answers = look(tmp_path, *requests)
    assert answers == [(200, without_state)] * len(invalid_states)


@pytest.mark.sampled(1)
def test_travel_violation_is_reported_in_preview(tmp_path: Path) -> None:
    """The first line beyond each end is reported, with the farthest position."""
    settings = {"20": "1", "22": "1", "130": "150", "131": "150", "132": "40"}
    program = "G0 X60\nX120 Y10\nX130\nZ-1\nZ-20\nX0\n"
    # $20: soft limits; $22: homing; options are those of $I.
    request = {**STANDING, "program": program, "settings": settings, "options": "VNM"}
    (_, found), (_, soft_limits_off), (_, homed_left) = look(
        tmp_path,
        request,
        {**request, "settings": {**settings, "20": "0"}},
        # X homes at its other end ($23), which is its zero then (Z in the options).
        {**request, "settings": {**settings, "23": "1"}, "options": "VNZ"},
    )
    assert [(row["line"], row["code"]) for row in found["problems"]] == [(2, 2), (5, 2)]
    assert found["problems"][0]["text"] == (
        # X130 with the offsets -100 and 1 is +31 mm.
        "ALARM:2 - X would go to 31.000 mm in machine coordinates, "
        "and its travel ends at 0 ($20, $130)"
    )
    assert "Z would go to -43.000 mm" in found["problems"][1]["text"]
    assert "ends at -40 ($20, $132)" in found["problems"][1]["text"]
    assert found["seconds"] == soft_limits_off["seconds"] and not soft_limits_off["problems"]
    assert [row["line"] for row in homed_left["problems"]] == [1, 5], "X goes from 0 to 150 there"


def test_reported_travel_violation_matches_machine() -> None:
    """The firmware's own soft limits refuse the same line."""
    from ugrbl.web.preview import preview as make_preview

    # Half circles of radius 4 mm; that of line 20 ends at X-98, beyond the travel of 94.5 mm.
    program = "".join(f"G0 X{-10 * n}\nG2 X{-10 * n - 8} I-4 F900\n" for n in range(12))
    settings = {"20": "1", "22": "1", "130": "94.5", "131": "50", "132": "50", "110": "6000"}
    preview = make_preview({"program": program, "settings": settings, "place": [0, -10, 0]}, "sim")
    setting_lines = [f"${n}={settings[n]}" for n in ("22", "20", "130", "131", "132", "110")]
    result, _ = run_program(
        program.encode().splitlines(), settings=[*setting_lines, "G90 G0 Y-10"]
    )
    assert result.stopped == "ALARM:2"
    alarm_line, _text = result.other_output[-1]
    assert [row["line"] for row in preview["problems"]] == [alarm_line] == [20]


def test_refused_lines_are_named_with_meaning(tmp_path: Path) -> None:
    """Each refused line is listed with its error code and words.

    Code 0 marks a realtime character: `!` in line 3 would hold the machine.
    """
    ((status, found),) = look(tmp_path, {"program": "G64\nG1 X1\nG0 X1 ! (hm?)\nM3 (Ä)\n"})
    assert status == 200
    assert [(row["line"], row["code"]) for row in found["problems"]] == [(1, 20), (2, 22), (3, 0)]
    assert found["problems"][0]["text"].startswith("error:20 - ")
    assert "feed hold" in found["problems"][2]["text"]


def test_percent_lines_at_both_ends_are_accepted(tmp_path: Path) -> None:
    ((status, found),) = look(tmp_path, {"program": "%\nG21\nG0 X5\n%\n"})
    assert (status, found["problems"], found["lines"]) == (200, [], 4)


def test_program_that_ends_in_alarm_names_line(tmp_path: Path) -> None:
    """The simulated probe never closes, so G38.2 ends in ALARM:5.

    The line after it is not reached.
    """
    ((status, found),) = look(tmp_path, {"program": "G21\nG38.2 Z-5 F200\nG0 X5\n"})
    assert status == 200
    (problem,) = found["problems"]
    assert (problem["line"], problem["code"]) == (2, 5)
    assert problem["text"].startswith("ALARM:5 - ")


def test_long_program_is_reported_in_few_points(tmp_path: Path) -> None:
    """Times and path are thinned out for a long program, but reach its end."""
    moves = "".join(f"G{n % 2} X{n % 3} Y{n % 7} F3000\n" for n in range(3_000))
    settings = {"110": "20000", "111": "20000", "120": "9000", "121": "9000"}
    ((status, found),) = look(tmp_path, {"program": moves, "settings": settings})
    assert status == 200 and found["lines"] == 3_000
    assert 1000 < len(found["times"]) <= MOST_TIMES
    assert 1000 < len(found["path"]) <= MOST_POINTS
    assert found["times"] == sorted(found["times"]) and found["times"][-1][0] == 3_000


@pytest.mark.parametrize(
    ("request_", "why"),
    [
        (b"{", "is no JSON"),
        (b"\xff\xfe", "is no JSON"),
        (b'"\xff"', "is no JSON"),
        (b"[" * 100_000, "is no JSON"),
        (b"[1]", "is no JSON object"),
        ({"name": "x.nc"}, "the request has no program"),
        ({"program": 7}, "the request has no program"),
        ({"program": "G0 X1", "settings": [1]}, '"settings" must be'),
        ({"name": "x.nc", "program": " \n"}, "x.nc is empty"),
        ({"name": "x.nc", "program": "PK\x03\x04\n"}, "x.nc is no G-code"),
        ({"program": "\ud800"}, ""),
    ],
)
def test_request_without_program_is_refused(request_: Any, why: str, tmp_path: Path) -> None:
    """A request that cannot be previewed is answered with 400 and the reason.

    why: the reason; "": it is accepted.
    """
    ((status, said),) = look(tmp_path, request_)
    if why:
        assert status == 400 and why in said and "Traceback" not in said
    else:
        assert status == 200


def test_too_large_request_is_refused(tmp_path: Path) -> None:
    """A program over 32 MB is refused with 400, a body that is larger still with 413."""
    # A program just over its limit, and a body that no program within the limit needs.
    program = {"program": "G0 X1\n" * (PROGRAM_BYTES // 6 + 1)}
    body = b"x" * (2 * PROGRAM_BYTES + (2 << 20))
    (program_status, program_answer), (body_status, body_answer) = look(tmp_path, program, body)
    assert program_status == 400 and "larger than 32 MB" in program_answer
    assert body_status == 413 and "at most 32 MB" in body_answer


def test_preview_that_takes_too_long_is_aborted(tmp_path: Path) -> None:
    ((status, said),) = look(tmp_path, {"program": _SQUARE}, longest_s=0.05)
    assert status == 504 and "within 0.05 s" in said


@played
async def test_newest_request_wins_and_bytes_flow_meanwhile(tmp_path: Path) -> None:
    """A new request for a preview ends the one under way, which is answered with 409.

    Bytes of the board are passed on meanwhile.
    """
    board = FakeBoard()
    long_request = {"program": "G1 F9000\n" + "X1\nX0\n" * 200_000}
    async with served(board, tmp_path) as site:
        page = await site.open()
        first_look = asyncio.create_task(site.look(long_request))
        await asyncio.sleep(1.0)  # the long preview is being computed
        board.say(b"ok\r\n")
        await page.wait("ok\r\n", seconds=1.0)
        status, found = await site.look({"program": _SQUARE})
        assert status == 200 and found["lines"] == 6
        assert (await first_look)[0] == 409
