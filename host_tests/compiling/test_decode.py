"""`ugrbl decode`: what a board tells of a fault, in the names and lines of the sources."""

import ast
import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from micropython_runner import needs_micropython, run_micropython
from typer.testing import CliRunner, Result
from ugrbl import paths
from ugrbl.cli.app import app
from ugrbl.compiling import build, maps, symbols
from ugrbl.compiling.decode import build_of, decode, is_fault

# Passes of the build, and what they make: the first ring takes a few.
pytestmark = pytest.mark.thorough

# A script that makes the firmware fail, as compiled, and tells as a board tells.
_FAILS = """
import sys
from base import errors
from boot import power_up
from motion.segments import Segments
from control.coords import Coords

for fails in (lambda: Segments(None), lambda: Coords(None, 0.5, 2)):
    try:
        fails()
    except Exception as fault:
        sys.print_exception(fault)
        print(power_up._line(power_up._text(fault)).decode())
"""


def ugrbl(*words: object, told: str = "") -> Result:
    return CliRunner().invoke(app, [str(word) for word in words], input=told)


def line_of(module: str, text: str) -> int:
    """Where a line of the firmware is, from 1."""
    lines = build.texts()[module].splitlines()
    (found,) = [number for number, line in enumerate(lines, 1) if text in line]
    return found


def span(module: str, function: str) -> str:
    """The lines of a function, as decode tells them."""
    spans = {name: lines for name, lines, _ in symbols.functions(ast.parse(build.texts()[module]))}
    return "lines {} to {}".format(*spans[function])


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> "dict[bool, Path]":
    """The firmware compiled for this computer, with map; with names and lines, too."""
    found = {}
    for debug in (False, True):
        found[debug] = tmp_path_factory.mktemp("built") / "x64"
        options = ["--debug"] if debug else []
        done = ugrbl("build", "--arch", "x64", "-o", found[debug], *options)
        assert done.exit_code == 0, done.output
    return found


@pytest.fixture(scope="module")
def told(folders: "dict[bool, Path]") -> "dict[bool, str]":
    """What each says of its faults."""
    return {debug: run_micropython(_FAILS, paths=[folder]) for debug, folder in folders.items()}


@pytest.fixture(scope="module")
def map_() -> Any:
    return maps.of(debug=False)


# A real MicroPython


@pytest.mark.thorough
@needs_micropython
def test_a_traceback_gets_names_and_the_lines_of_functions(
    folders: "dict[bool, Path]", told: "dict[bool, str]"
) -> None:
    done = ugrbl("decode", "--map", maps.beside(folders[False]), told=told[False])
    assert done.exit_code == 0
    short = maps.read(maps.beside(folders[False]))["modules"]["motion.segments"]["attributes"]
    (flow,) = [name for name, long in short.items() if long == ["flow"]]
    assert f"'NoneType' object has no attribute '{flow}'" in told[False]
    assert "'NoneType' object has no attribute 'flow'" in done.output
    where = span("motion.segments", "Segments.__init__")
    # In the traceback, and in the message of one line.
    assert done.output.count(f"    motion/segments.py, {where}: Segments.__init__\n") == 2
    assert f"    base/f32.py, {span('base.f32', 'vector')}: vector\n" in done.output
    assert "AttributeErr:" in told[False] and "AttributeErr:" not in done.output


@pytest.mark.thorough
@needs_micropython
def test_a_debug_build_tells_names_and_its_map_the_very_line(
    folders: "dict[bool, Path]", told: "dict[bool, str]"
) -> None:
    assert "object has no attribute 'flow'" in told[True]
    done = ugrbl("decode", "--map", maps.beside(folders[True]), told=told[True])
    line = line_of("motion.segments", "self._flow = planner.flow")
    assert f"    motion/segments.py, line {line}: Segments.__init__\n" in done.output
    line = line_of("control.coords", "self.offsets = vector(")
    assert f"    control/coords.py, line {line}: Coords.__init__\n" in done.output


@needs_micropython
def test_the_map_is_found_by_the_build_that_the_message_tells(told: "dict[bool, str]") -> None:
    for debug, text in told.items():
        assert build_of(text) == build.prepared_firmware(debug, "x64").id
        done = ugrbl("decode", told=text)
        assert done.exit_code == 0 and "motion/segments.py, line" in done.output


def test_a_map_that_cannot_be_read_hides_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(maps, "_BUILT", tmp_path)
    (tmp_path / f"a{maps.SUFFIX}").mkdir()
    (tmp_path / f"b{maps.SUFFIX}").write_text('{"id": "b", "modules": {}, "classes": {}}')
    assert maps.find("b").where == str(tmp_path / f"b{maps.SUFFIX}")


@pytest.mark.thorough
def test_lines_of_a_debug_build_are_those_of_the_sources() -> None:
    """Statement by statement, wherever a pass has moved them."""
    texts, made = build.texts(), build.prepared_firmware(True, "x64")
    modules = maps.of(True, "x64")["modules"]
    moved = 0
    for module, text in texts.items():
        before, after = text.splitlines(), made.texts[module].splitlines()
        for told, line in modules[module]["lines"].items():
            name = after[int(told) - 1].strip().partition("(")[0]
            if name.startswith("def "):
                assert before[line - 1].strip().startswith(f"{name}("), f"{module}:{line}"
                moved += int(told) != line
    assert moved > 20


# What the text says


def say(text: str, map_: Any) -> list[str]:
    return list(decode(text, map_))


def test_what_senders_would_misread_is_read_as_it_was(map_: Any) -> None:
    text = '[MSG:ValueErr: to-ken File "ports.usb.usb_link", line 1, in _loo-k (12345678)]'
    said = say(text, map_)
    assert said[0] == 'ValueError: token File "ports.usb.usb_link", line 1, in _look (12345678)'
    lines = span("ports.usb.usb_link", "UsbLink._look")
    assert said[1:] == [f"    ports/usb/usb_link.py, {lines}: UsbLink._look"]
    said = say('[MSG:TypeErr: x File "talk.report", line 1, in Err (12345678)]', map_)
    assert said[1].endswith(": Report.error")


def test_a_message_that_was_cut_names_what_it_may_be(map_: Any) -> None:
    (_, found) = say('[MSG:TypeErr: x File "base.faults", line 1, in harml (12345678)]', map_)
    assert found.endswith(": harmless")
    (_, found) = say('[MSG:TypeErr: x File "boot.power_up", line 1, (12345678)]', map_)
    assert found.startswith("    boot/power_up.py, lines 1 to ")


def test_a_private_method_is_known_by_its_short_name(map_: Any) -> None:
    names = map_["modules"]["talk.commands"]["attributes"]
    (short,) = [name for name, long in names.items() if "_check_mode" in long]
    (_, *found) = say(f'  File "talk.commands", line 1, in {short}', map_)
    where = span("talk.commands", "Commands._check_mode")
    assert f"    talk/commands.py, {where}: Commands._check_mode" in found


def test_an_attribute_is_known_by_its_class(map_: Any) -> None:
    for short, name in map_["classes"]["Planner"].items():
        (said,) = say(f"AttributeError: 'Planner' object has no attribute '{short}'", map_)
        assert said.endswith(f"attribute '{name}'")
    assert len(map_["classes"]["Planner"]) > 3


def test_what_is_not_ours_stays(map_: Any) -> None:
    text = '  File "mine.py", line 3, in any\nValueError: any\n[MSG:Pgm End]\nok'
    assert say(text, map_) == [*text.splitlines()[:2], "Pgm End", "ok"]


@pytest.mark.parametrize(
    ("text", "number", "fault"),
    [
        ('[MSG:X File "a", line 1, in f (12ab34cd)]', "12ab34cd", True),
        ("[MSG:Build: 12ab34cd]", "12ab34cd", False),
        ("[MSG:Pgm End]", "", False),
        ('File "a", line 1, in f (--------)', "--------", True),
    ],
)
def test_a_text_is_asked_for_its_build(text: str, number: str, fault: bool) -> None:
    assert build_of(text) == number and is_fault(text) == fault


# Maps


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("UGRBL_MAPS", str(tmp_path / "maps"))
    monkeypatch.chdir(tmp_path)
    yield tmp_path / "maps"


def a_map(number: str) -> "dict[str, Any]":
    return {"id": number, "debug": False, "classes": {}, "modules": {}}


def test_a_map_of_another_build_is_found_where_it_was_built_or_deployed(kept: Path) -> None:
    maps.keep(a_map("11111111"))
    maps.save(a_map("22222222"), Path("build") / "mine.map.json")
    (kept / "broken.map.json").write_text("{")
    assert maps.find("11111111").where == str(kept / "11111111.map.json")
    assert maps.find("22222222").where == str(Path("build") / "mine.map.json")


def test_where_no_map_fits_the_words_say_what_there_is(kept: Path) -> None:
    maps.keep(a_map("11111111"))
    done = ugrbl("decode", told='[MSG:TypeErr: x File "a", line 1, in f (99999999)]')
    assert done.exit_code == 1
    for words in ("no map of the build 99999999", "maps of 11111111", "--map FILE"):
        assert words in done.output


def test_a_map_of_another_build_is_refused(kept: Path, tmp_path: Path) -> None:
    maps.save(a_map("11111111"), tmp_path / "one.map.json")
    told = "[MSG:Build: 99999999]"
    done = ugrbl("decode", "--map", tmp_path / "one.map.json", told=told)
    assert done.exit_code == 1 and "has the build 99999999" in done.output
    (tmp_path / "no.json").write_text(json.dumps({"id": 1}))
    assert "is no map" in ugrbl("decode", "--map", tmp_path / "no.json").output
    assert "no such file" in ugrbl("decode", "--map", tmp_path / "none.json").output
    assert ugrbl("decode", tmp_path / "none.txt").exit_code == 1


def test_sources_need_no_map() -> None:
    done = ugrbl("decode", told='[MSG:TypeErr: x File "a.py", line 7, in long (--------)]')
    assert done.exit_code == 0 and done.output.startswith("TypeError: x File")


def test_the_oldest_maps_go(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(maps, "_MOST", 3)
    for number in range(5):
        maps.keep(a_map(f"0000000{number}"))
        file = kept / f"0000000{number}.map.json"
        os.utime(file, (time.time() - 100 + number,) * 2)
    assert len([*kept.glob("*.json")]) == 3 and (kept / "00000004.map.json").exists()


def test_every_build_has_its_id_once_and_tells_it() -> None:
    made = build.prepared_firmware()
    other = build.prepared_firmware(debug=True)
    assert made.id != other.id and made.id in made.texts["base.errors"]
    assert symbols.OF_SOURCES not in made.texts["base.errors"]
    assert sum(made.id in text for text in made.texts.values()) == 1
    moved = {**build.texts(), "base.axes": "\n" + build.texts()["base.axes"]}
    unstamped = made._replace(texts={})
    ids = {symbols.stamped(texts, unstamped).id for texts in (build.texts(), moved)}
    assert len(ids) == 2
    assert (paths.FIRMWARE / "base" / "errors.py").read_text().count(symbols.OF_SOURCES) == 1


# Where a package is one module on the board


def test_a_function_of_a_bundle_is_looked_for_in_its_package(map_: Any) -> None:
    told = '[MSG:ValueErr: wrong File "control", line 1, in finish]'
    found = list(decode(told, map_))
    assert any("control/canon.py" in line and "Canon.finish" in line for line in found)
    assert any("control/saves.py" in line and "Saves.finish" in line for line in found)
    assert not any("talk/" in line for line in found)


def test_a_name_that_clashed_in_a_bundle_is_known(map_: Any) -> None:
    renamed = {**map_, "bundles": {"control": {"finish_2": ["control.saves", "finish"]}}}
    told = '[MSG:ValueErr: wrong File "control", line 1, in finish_2]'
    found = list(decode(told, renamed))
    assert [line for line in found if "control/" in line and "File" not in line] == [
        f"    control/saves.py, {span('control.saves', 'Saves.finish')}: Saves.finish"
    ]
