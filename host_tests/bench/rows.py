"""Rows of the table, and the figures of Grbl 1.1h on its own chip for comparison."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

_RECORDED = Path(__file__).resolve().parents[3] / "shared" / "grbl-performance.json"

# Recorded cycle by cycle on an emulated ATmega328P at 16 MHz: path in grbl-performance.json (in
# the project's shared folder), its figure, unit.
_GRBL: "dict[str, tuple[tuple[str, ...], Any, str]]" = {
    "streamed": (("b_lines_per_second", "xy_22_chars_115200"), 350, "lines/s"),
    "checked": (("b_lines_per_second", "check_mode_g1_22_chars_fast_serial"), 1330, "lines/s"),
    "empty": (("b_lines_per_second", "empty_lines_fast_serial"), 20849, "empty lines/s"),
    "asked at rest": (
        ("c_status_query_latency_us", "idle"),
        [40, 46, 52],
        "us: least, mean, most",
    ),
    "asked": (
        ("c_status_query_latency_us", "streaming_short_segments_367_lines_per_s"),
        [124, 1025, 2881],
        "us: least, mean, most",
    ),
    "held": (("d_feed_hold", "x_10kHz"), [40.1, 44.9, 49.7], "ms: least, mean, most"),
    "1 axis": (("a_step_rate_hz", "one_axis", "quiet"), 32000, "Hz (10 us)"),
    "2 axes": (("a_step_rate_hz", "two_axes", "quiet"), 29000, "Hz (10 us)"),
    "3 axes": (("a_step_rate_hz", "three_axes", "quiet"), 26500, "Hz (10 us)"),
    "first start": (("f_boot_ms", "blank_memory_banner_complete"), 401.9, "ms"),
    "start": (("f_boot_ms", "banner_line_complete"), 28.41, "ms"),
}


class Row(NamedTuple):
    """One figure of the table; grbl is a key of the figures above, or empty."""

    name: str
    figure: float
    unit: str = ""
    grbl: str = ""


def text(rows: "Sequence[Row]") -> str:
    """Return a line of the table: one row as measured in each column."""
    first = rows[0]
    figures = "".join(f"{_figure(row):>9}" for row in rows)
    beside = f"Grbl {grbl(first.grbl)}" if first.grbl else ""
    return f"{first.name:<48}{figures} {first.unit:<8} {beside}".rstrip()


def head(columns: "Sequence[str]") -> str:
    """Return the heading of the columns."""
    return " " * 48 + "".join(f"{column:>9}" for column in columns)


def _figure(row: Row) -> str:
    return f"{row.figure:.0f}" if abs(row.figure) >= 1000 else f"{row.figure:.2f}"


def grbl(key: str) -> str:
    """Return Grbl's figure: from the recorded file if it exists, else from the table above."""
    path, noted, unit = _GRBL[key]
    figure = noted
    if _RECORDED.is_file():
        figure = json.loads(_RECORDED.read_text(encoding="utf-8"))
        for part in path:
            figure = figure[part]
    text = ", ".join(map(str, figure)) if isinstance(figure, list) else str(figure)
    return f"{text} {unit}"
