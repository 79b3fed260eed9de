"""The firmware's marks say what its names are: none is missing, none is stale."""

import ast
import re
from pathlib import Path

import pytest
from ugrbl import paths
from ugrbl.compiling import build, marks
from ugrbl.compiling.inline import inline
from ugrbl.compiling.leaves import leaves
from ugrbl.compiling.marks import Marks
from ugrbl.compiling.scan import ON_REQUEST
from ugrbl.compiling.shorten import Shortened, shorten

# Passes of the build, and what they make: the first ring takes a few.
pytestmark = pytest.mark.thorough

_HERE = Path(__file__).resolve().parents[1]
# Whose scripts run on a board, where they ask the firmware's objects for names.
_ON_BOARD = (_HERE / "emulator", _HERE / "bench")


@pytest.fixture(scope="module")
def made() -> Shortened:
    return build.prepared_firmware(arch="x64")


@pytest.fixture(scope="module")
def found() -> Marks:
    return marks.read(build.texts())


def on_boards() -> set[str]:
    """What objects of MicroPython's hardware modules have: the stand-ins' functions."""
    return {
        node.name
        for file in paths.STANDINS.glob("*.py")
        for node in ast.walk(ast.parse(file.read_text("utf-8")))
        if isinstance(node, ast.FunctionDef) and node.name[0] != "_"
    }


def asked_by_scripts() -> set[str]:
    """Attributes in what runs on a board for a test or the benchmark."""
    files = [file for folder in _ON_BOARD for file in folder.glob("*.py")]
    return {
        name for file in files for name in re.findall(r"\bself\.(\w+)", file.read_text("utf-8"))
    }


@pytest.mark.thorough
def test_no_name_that_becomes_short_is_one_of_a_board(made: Shortened) -> None:
    """If this fails: `# keep-name:` where the attribute is made, see compiling/marks.py."""
    assert not made.names.keys() & on_boards()
    assert len(made.names) > 300


def test_every_name_kept_would_be_short_and_is_anothers_too(found: Marks) -> None:
    made = shorten(inline(build.texts()), found._replace(kept={}))
    free = made.names
    for name, reason in found.kept.items():
        if reason.startswith("custom.py may say"):  # a parameter
            rooms = ("handlers", "machine_operator", "operator_pins")
            text = "".join(made.texts[f"extras.custom.{room}"] for room in rooms)
            assert not re.search(rf"\b{name}: .+ = ", text), f"{name} needs no mark ({reason})"
            continue
        assert name in free, f"{name} needs no mark ({reason})"
        assert name in on_boards() | asked_by_scripts(), f"{name}: who has it? ({reason})"


def test_every_marked_column_has_names_of_attributes(found: Marks, made: Shortened) -> None:
    texts = build.texts()
    for table in found.tables:
        only = found._replace(tables={table: found.tables[table]})
        tree = ast.parse(texts[table.module])
        names = {name for _, name in marks.names(table.module, tree, only)}
        on_request = table.module.partition(".")[0] in ON_REQUEST  # others come before these
        assert on_request or names & made.names.keys(), f"{table}: none of these becomes short"
        assert all(map(str.isidentifier, names)), f"{table}: {names}"


def test_every_prefix_kept_is_one_of_methods(found: Marks) -> None:
    texts = "".join(build.texts().values())
    assert found.prefixes
    for prefix, reason in found.prefixes.items():
        assert re.search(rf"    def {prefix}\w+\(self", texts), f"{prefix}: {reason}"


@pytest.mark.thorough
def test_every_function_marked_for_its_calls_would_be_treated_otherwise(found: Marks) -> None:
    sources = inline(build.texts())

    def mentions(only: Marks) -> "dict[marks.Key, int]":
        text = "".join(leaves(sources, only).values())
        return {key: len(re.findall(rf"\b{key[1]}\(", text)) for key in found.inline}

    marked, free = mentions(found), mentions(found._replace(inline={}))
    for key, how in found.inline.items():
        less, more = (marked, free) if how == "always" else (free, marked)
        assert less[key] < more[key], f"{key}: the mark changes nothing"


def test_without_its_mark_a_table_is_asked_about(found: Marks) -> None:
    module = "base.settings"
    less = {table: column for table, column in found.tables.items() if table.module != module}
    with pytest.raises(ValueError, match=f"{module}: is .* the name of an attribute"):
        shorten(inline(build.texts()), found._replace(tables=less))
