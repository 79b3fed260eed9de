"""Constants that stand in two files are the same in both.

Viper takes constants of its own module only, as the sources are run here and by `mip install`.
Where it needs another module's, a copy stands below a comment that says whose:
`# From pio/hub.py, motion/kernels.py.`, up to the next line that is no constant. A copy has the
original's name, but for the underscore in front.
"""

import ast
import re
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).parent.parent / "firmware"
FILES = {path.relative_to(FIRMWARE).as_posix(): path for path in sorted(FIRMWARE.rglob("*.py"))}

_CONSTANT = re.compile(r"(\w+) = const\((.+?)\)\s*(#.*)?$")
_HEADING = re.compile(r"# From ((?:[\w/]+\.py(?:, )?)+)\.")
# What else says of a constant, or of those below, that they are another file's.
_CLAIM = re.compile(r"(?i)(\bas\b|the same as|^\s*# from) (in )?`?[\w/]+\.py\b")


def constants(text: str) -> "dict[str, int]":
    """All constants of a module."""
    found: dict[str, int] = {}
    for line in text.splitlines():
        if match := _CONSTANT.match(line):
            value = eval(match[2], {"__builtins__": {}}, dict(found))
            if isinstance(value, int):
                found[match[1]] = value
    return found


def copies(text: str) -> "list[tuple[str, list[str]]]":
    """Names of constants below a heading, each with the files it may be from."""
    found = []
    sources: list[str] = []
    for line in text.splitlines():
        if heading := _HEADING.match(line):
            sources = heading[1].split(", ")
        elif match := _CONSTANT.match(line):
            if sources:
                found.append((match[1], sources))
        else:
            sources = []
    return found


def wrong(texts: "dict[str, str]") -> "list[str]":
    """Copies that have no original, or another value."""
    known = {name: constants(text) for name, text in texts.items()}
    found = []
    for name, text in texts.items():
        for copy, sources in copies(text):
            bare = copy.lstrip("_")
            values = [known[s][n] for s in sources for n in (bare, f"_{bare}") if n in known[s]]
            if known[name][copy] not in values[:1]:
                found.append(f"{name}: {copy} is {known[name][copy]}, in {sources} {values[:1]}")
    return found


TEXTS = {name: path.read_text() for name, path in FILES.items()}


def test_every_copy_is_what_the_original_is() -> None:
    assert wrong(TEXTS) == []


@pytest.mark.parametrize("name", FILES)
def test_copies_say_where_they_are_from_in_one_form(name: str) -> None:
    claims = [line for line in TEXTS[name].splitlines() if _CLAIM.search(line)]
    constant = [line for line in claims if _CONSTANT.match(line) or line.startswith("#")]
    assert [line for line in constant if not _HEADING.match(line)] == []


# What these take from there cannot be imported: the layer is higher; the import leads back.
_ELSEWHERE = {"ports/input_pins.py": "control/inputs.py", "ports/usb_ring.py": "ports/usb_link.py"}


@pytest.mark.parametrize("name", [name for name, text in TEXTS.items() if copies(text)])
def test_only_a_viper_has_copies(name: str) -> None:
    """Plain Python imports a constant, which costs nothing when it is built."""
    vipers = {
        used.id
        for node in ast.walk(ast.parse(TEXTS[name]))
        if isinstance(node, ast.FunctionDef)
        and any("viper" in ast.unparse(decorator) for decorator in node.decorator_list)
        for used in ast.walk(node)
        if isinstance(used, ast.Name)
    }
    found = [copy for copy, sources in copies(TEXTS[name]) if sources != [_ELSEWHERE.get(name)]]
    assert [copy for copy in found if copy not in vipers] == [], "import these"


def test_a_copy_that_differs_is_found() -> None:
    texts = {
        "motion/kernels.py": "AT = const(7)\n_DUE = const(1 + 1)\nEND = const(4)\n",
        "pio/hub.py": "# From motion/kernels.py.\n_AT = const(8)  # where\n_DUE = const(2)\n"
        "\nEND = const(3)\n",
        "pio/stops.py": "# From pio/hub.py, motion/kernels.py.\nEND = const(4)\nGONE = const(1)\n",
    }
    assert [text.partition(" is ")[0] for text in wrong(texts)] == [
        "pio/hub.py: _AT",
        "pio/stops.py: END",
        "pio/stops.py: GONE",
    ]
