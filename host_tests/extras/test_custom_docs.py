"""Test docs/custom.md: its code works, its lists are complete.

Names that custom.py uses also exist on a board. blocks("python", "board") are the page's code
blocks that begin with ```python board. Shop, a machine, is explained in test_custom_examples.py.
"""

import ast
import re
from pathlib import Path
from typing import Any

import pytest
from extras.custom import handlers
from test_custom_examples import Shop
from typer.testing import CliRunner
from ugrbl.cli.app import app
from ugrbl.docs.custom import machine_api_methods

# Many cases: the first ring runs a sample of them.
pytestmark = pytest.mark.sampled(2)

_ROOT = Path(__file__).resolve().parents[2]
_PAGE = (_ROOT / "docs" / "custom.md").read_text(encoding="utf-8")
_BLOCK = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_EVENT = re.compile(r"^\| `@on\.(\w+)[^|]*\|[^|]*\| (yes|no) \|", re.MULTILINE)


def blocks(kind: str, name: str = "") -> "list[str]":
    return [text for k, n, text in _BLOCK.findall(_PAGE) if (k, n) == (kind, name)]


def cnc_with(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, text: str) -> Shop:
    """Return a machine with this custom.py, and the pins that the page names."""
    pins: dict[str, Any] = {}
    exec(blocks("python", "board")[0], pins)
    cnc = Shop(monkeypatch, "custom", OUTPUTS=pins["OUTPUTS"], INPUTS=pins["INPUTS"])
    (tmp_path / "custom.py").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return cnc


@pytest.mark.parametrize("text", blocks("python", "custom.py"), ids=("first", "saved"))
def test_code_of_the_page_is_accepted(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, text: str
) -> None:
    cnc = cnc_with(monkeypatch, tmp_path, text)
    cnc.say("$I")
    assert any(line.startswith("Custom: ") for line in cnc.messages), cnc.messages


def test_first_word_does_what_the_page_says(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The page's first custom.py (M100 P1/P0 switches the vacuum) runs the page's G-code."""
    cnc = cnc_with(monkeypatch, tmp_path, blocks("python", "custom.py")[0])
    lines = blocks("gcode")[0].splitlines()
    # The page says that P must be 0 or 1 (error 3), and is required (error 28).
    assert cnc.say(*lines, "M100 P3", "M100") == ["ok"] * len(lines) + ["error:3", "error:28"]
    # The record of outputs: name, level, and X in mm where it changed.
    assert [(name, on, place[0]) for name, on, place in cnc.output_changes] == [
        ("vacuum", True, 0),
        ("vacuum", False, 50),
    ]
    assert cnc.messages == ["M100: P1 is on, P0 is off"]


def test_tool_change_of_the_page_works(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """T3 M6 moves to the change position in mm, also with G20, and asks for the tool."""
    cnc = cnc_with(monkeypatch, tmp_path, blocks("python", "custom.py")[1])

    def script() -> Any:
        yield from cnc.send("G20")
        yield from cnc.start("T3 M6")  # waits for the hold
        assert cnc.position_mm() == (3, 139, -1)  # mm
        yield from cnc.start("~", "Idle")  # cycle start; waits for idle

    cnc.run(script())
    assert cnc.messages == ["Put in tool 3, then cycle start"] and cnc.answers == ["ok"] * 2


def test_failure_is_reported_as_the_page_quotes_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Line 7 of this custom.py fails, after a move that is completed."""
    head = "from ugrbl import mcode\n\n\n@mcode(100)\ndef fail(m):\n"
    text = head + "    m.g('G1 X1 F1000')\n    1 / 0\n"
    cnc = cnc_with(monkeypatch, tmp_path, text)
    cnc.say("M100")
    assert "[MSG:M100: custom.py, line 7, in fail: …]" in _PAGE
    assert cnc.messages[0].startswith("M100: custom.py, line 7, in fail: ZeroDivision")
    assert "ALARM:34" in cnc.answers and cnc.position_mm()[0] == 1


def test_page_lists_every_event_and_if_it_may_move() -> None:
    """The table of the page has every event of the firmware, with "yes" if it may move."""
    listed = dict(_EVENT.findall(_PAGE))
    may_move = dict.fromkeys(handlers.MOVING, "yes")
    may_not = dict.fromkeys((*handlers.DURING_MOTION, handlers.REPORT, handlers.INPUT), "no")
    assert listed == {**may_move, **may_not}


def test_page_lists_every_example() -> None:
    listed = re.findall(r"^\| `(\w+\.py)` \|", _PAGE, re.MULTILINE)
    assert sorted(listed) == sorted(f.name for f in (_ROOT / "examples" / "custom").glob("*.py"))


@pytest.mark.parametrize(
    "file", sorted((_ROOT / "examples" / "custom").glob("*.py")), ids=lambda file: file.stem
)
def test_every_example_passes_the_command_at_its_head(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Run "ugrbl custom check FILE", with the options that "Checked by:" in the file adds."""
    monkeypatch.chdir(file.parent)
    checked_by = re.search(r"^Checked by: ugrbl (.*)$", file.read_text(), re.MULTILINE)
    words = checked_by[1].split() if checked_by else ["custom", "check", file.name]
    assert words[:3] == ["custom", "check", file.name]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output


# Names on a board


def public(text: str) -> "set[str]":
    """Return functions, classes and methods whose names do not begin with _."""
    nodes = (node for node in ast.walk(ast.parse(text)) if isinstance(node, _NAMED))
    return {node.name for node in nodes if not node.name.startswith("_")}


_NAMED = (ast.FunctionDef, ast.ClassDef)


def test_every_call_has_a_docstring() -> None:
    methods = list(machine_api_methods())
    assert len(methods) > 20 and all(map(ast.get_docstring, methods))


def test_failure_during_motion_stops_within_a_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Thirty lines of 100 mm fill the planner: the main loop waits within a line for space. A
    failing handler must stop the motion there too, not only between lines."""
    text = "from ugrbl import on\n\n\n@on.input('part')\ndef fail(m, closed):\n    1 / 0\n"
    cnc = cnc_with(monkeypatch, tmp_path, text)

    def script() -> Any:
        yield from cnc.send("G1 X200 F1000\n" + "Y100\nY0\n" * 15, "ms 1000")
        cnc.close("part")  # the input whose handler fails
        yield from cnc.until("Alarm")

    cnc.run(script())
    # After 1 s at 1000 mm/min (16.7 mm) and the way to stop.
    assert "ALARM:34" in cnc.answers and cnc.position_mm()[0] < 19
