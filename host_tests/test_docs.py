"""What the documents say is true: tables, names, and what senders look for in our words."""

import ast
import re
from pathlib import Path

import pytest
from ugrbl import docs
from ugrbl.gcode_file import split_lines
from ugrbl.messages import alarms, errors
from ugrbl.run import run_program

_ROOT = Path(__file__).resolve().parent.parent
_FIRMWARE = _ROOT / "firmware"
_README = (_ROOT / "README.md").read_text(encoding="utf-8")
_CHANGELOG = (_ROOT / "CHANGELOG.md").read_text(encoding="utf-8")

# The way of a line through the firmware: whoever reads of it must meet all of these.
_STATIONS = set("protocol lines gcode words block checks motion planner kernels segments".split())

_SECTION = re.compile(r"^## Life of a G1$(.*?)^## ", re.MULTILINE | re.DOTALL)
_NAME = re.compile(r"`([a-z_]\w*(?:\.\w+)+)`")
_LINK = re.compile(r"\]\(([^)#]+)(?:#[^)]*)?\)")
_HEADING = re.compile(r"^#+ (.*)$", re.MULTILINE)
_RELEASE = re.compile(r"^## \[(Unreleased|\d{4}-\d{2}-\d{2}|[^]]+\] - \d{4}-\d{2}-\d{2})", re.M)

# Answers that consist of these words; nothing else may contain them.
_ANSWERS = ("OK", "_ERROR")
_TAKEN = re.compile("ok|error", re.IGNORECASE)


def in_readme(word):
    return f"`{word}`" in _README


# Tables


def test_the_tables_are_up_to_date():
    for page in docs.PAGES:
        text = page.read_text(encoding="utf-8")
        assert docs.update(text) == text, "make docs"


def test_every_table_has_its_place():
    for name in docs.TABLES:
        pages = "".join(page.read_text(encoding="utf-8") for page in docs.PAGES)
        assert pages.count(f"<!-- begin: {name} -->") == 1
        assert pages.count(f"<!-- end: {name} -->") == 1


def test_every_code_is_in_the_readme():
    from language import block

    words = docs.g_words() + docs.m_words()
    numbers = {(word[0], int(word[1:].partition(".")[0])) for word in words}
    assert numbers == {("G", g) for g in block._G_WORDS} | {("M", m) for m in block._M_WORDS}
    assert [word for word in words if not in_readme(word)] == []


def test_every_command_and_byte_is_in_the_readme():
    from base import state
    from control import overrides, realtime

    letters = [command[1] for command in docs._COMMAND.findall(docs._source("talk/commands"))]
    assert len(letters) == 10
    assert [letter for letter in letters if f"`${letter}" not in _README] == []
    numbers = [realtime._SOFT_RESET, *state.EVENTS, *overrides._OVERRIDES]
    assert [number for number in numbers if f"`0x{number:02X}`" not in _README] == []


def test_every_setting_has_a_comment_and_is_in_the_readme():
    from base import settings

    numbers = [row[0] for row in settings._TABLE]
    assert list(docs.setting_comments()) == numbers
    assert [number for number in numbers if not in_readme(f"${number}")] == []


def test_every_error_and_alarm_is_in_the_readme():
    assert [number for number in errors() if not in_readme(f"error:{number}")] == []
    assert [number for number in alarms() if not in_readme(f"ALARM:{number}")] == []


def test_every_board_and_option_is_in_the_readme():
    files = [path.name for path in (_ROOT / "boards").glob("[!_]*.py")]
    assert [name for name in files if not in_readme(name)] == []
    readers = ("boot/wiring.py", "ports/input_pins.py", "ports/port.py")
    source = "".join((_FIRMWARE / name).read_text(encoding="utf-8") for name in readers)
    options = re.findall(r'\boption\("(\w+)"', source)
    assert {"STEP", "ESTOP", "INVERT"} <= set(options)
    assert [name for name in options if not in_readme(name)] == []


def test_a_row_without_a_comment_is_named(monkeypatch):
    monkeypatch.setattr(docs, "_source", lambda module: "_TABLE = (\n    (7, 'x'),\n)\n")
    with pytest.raises(ValueError, match=r"\$7 has no comment"):
        docs.setting_comments()


# Names


def members(body):
    """Every name that statements define, methods and attributes of objects as Class.name."""
    for node in body:
        if isinstance(node, ast.FunctionDef):
            yield node.name
        elif isinstance(node, ast.ClassDef):
            yield node.name
            yield from (f"{node.name}.{name}" for name in members(node.body))
            yield from (f"{node.name}.{name}" for name in attributes(node))
        elif isinstance(node, ast.Assign):
            yield from (ast.unparse(target) for target in node.targets)
        elif isinstance(node, ast.AnnAssign):
            yield ast.unparse(node.target)


def attributes(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            if ast.unparse(node.value) == "self":
                yield node.attr


def exists(name):
    parts = name.split(".")
    for count in range(len(parts) - 1, 0, -1):
        path = _FIRMWARE.joinpath(*parts[:count]).with_suffix(".py")
        if path.exists():
            tree = ast.parse(path.read_text(encoding="utf-8"))
            return ".".join(parts[count:]) in members(tree.body)
    return False


def test_names_are_looked_up():
    assert exists("state.State.pending")
    assert exists("kernels.fill")
    assert not exists("kernels.fil")
    assert not exists("nobody.knows")


def test_every_name_in_the_life_of_a_g1_exists():
    names = _NAME.findall(_SECTION.search(_README)[1])
    assert {name.partition(".")[0] for name in names} >= _STATIONS
    assert [name for name in names if not exists(name)] == []


def test_every_link_leads_somewhere():
    files = [link for link in _LINK.findall(_README) if "://" not in link]
    assert [link for link in files if not (_ROOT / link).exists()] == []
    anchors = {heading.lower().replace(" ", "-") for heading in _HEADING.findall(_README)}
    assert set(re.findall(r"\]\(#([^)]+)\)", _README)) <= anchors


def test_the_picture_is_small():
    assert docs.PICTURE.stat().st_size < 300_000


def test_the_changelog_has_a_section():
    assert _RELEASE.search(_CHANGELOG)


# Words that senders look for


def strings(tree):
    """Every text in a module but its docstrings and the answers themselves."""
    hidden = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            hidden.add(id(node.value))
        elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) in _ANSWERS:
            hidden.update(id(part) for part in ast.walk(node.value))
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and id(node) not in hidden:
            if isinstance(node.value, (str, bytes)):
                text = node.value
                yield text.decode("latin-1") if isinstance(text, bytes) else text


def annotations(tree):
    """Texts that are types."""
    for node in ast.walk(tree):
        for part in (getattr(node, "annotation", None), getattr(node, "returns", None)):
            if isinstance(part, ast.Constant):
                yield part.value


def sent_texts(module):
    """What a module may send as it stands: report's texts, and whatever goes into a message."""
    tree = ast.parse((_FIRMWARE / module).read_text(encoding="utf-8"))
    if module == "talk/report.py":
        types = set(annotations(tree))
        yield from (text for text in strings(tree) if text not in types)
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("message"):
            yield from strings(node)
        elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]).startswith("MSG_"):
            yield from strings(node)


def test_no_message_contains_an_answer():
    """A sender may look for `ok` or `error` anywhere in a line."""
    modules = [path.relative_to(_FIRMWARE).as_posix() for path in _FIRMWARE.rglob("*.py")]
    texts = [text for module in modules for text in sent_texts(module)]
    assert "Pgm End" in texts
    assert "ALARM:%d\r\n" in texts
    assert [text for text in texts if _TAKEN.search(text)] == []


def test_build_info_names_grbl_and_no_other():
    result, _ = run_program(split_lines(b"$I"))
    answer = "".join(text for _, text in result.other_output)
    assert "Grbl" in answer
    assert "grblhal" not in answer.lower()
