"""The rooms of tools/: each imports only from lower ones, nothing leads back, all stays short."""

import ast
import re
from functools import cache
from pathlib import Path

from test_layers import circles, too_long

TOOLS = Path(__file__).parents[2] / "tools"

# Who may import whom, what only mypy reads included. Everybody may import paths.
ROOMS: "dict[str, tuple[str, ...]]" = {
    "grbl": (),
    "sim": (),
    "boardfile": ("grbl", "sim"),
    "compiling": ("boardfile",),
    "run": ("grbl", "sim", "boardfile", "compiling"),
    "draw": ("grbl", "sim", "boardfile", "run"),
    "replay": ("boardfile", "compiling"),
    "device": ("grbl", "boardfile", "compiling", "run"),
    "image": ("boardfile", "compiling", "run", "device"),
    "web": ("grbl", "sim", "run", "draw", "compiling", "device"),
    "docs": ("grbl", "boardfile", "replay"),
}
ROOMS["cli"] = tuple(ROOMS)
GROUND = ("", "paths")  # the package itself, for its version
# What draws on a terminal and ends a command. `make docs` is one, too; kernels asks typer where
# a user's files lie.
SCREEN = ("typer", "rich", "prompt_toolkit")
SCREENS = ("cli", "docs.__main__", "compiling.kernels")

# Modules that write otherwise than by paths.write(): into a folder that is temporary or made once,
# a disk's image, or our docs.
WRITERS = {
    "compiling.compilers",
    "compiling.kernels",
    "compiling.machine_code",
    "compiling.page_files",
    "docs.__main__",
    "image.file_system",
    "paths",
}
_WRITING = ("write_text", "write_bytes")

# What a CPython reads in the place of a board's modules: no package, see test_stubs.py.
STANDINS = TOOLS / "sim" / "standins"
FILES = sorted(
    path
    for suffix in ("*.py", "*.pyi")
    for path in TOOLS.rglob(suffix)
    if STANDINS not in path.parents
)


@cache
def trees():
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in FILES}


def module_name(path: Path) -> str:
    """`draw.page`; a package by its own name, and "" is the whole."""
    parts = path.relative_to(TOOLS).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in FILES}


def base(node: ast.ImportFrom, path: Path) -> "str | None":
    """The module or package that something is imported from; None for a stranger's."""
    if not node.level:
        assert not re.match(r"(ugrbl|tools)\b", node.module or ""), "import it from . or .."
        return None
    package = path.relative_to(TOOLS).parent.parts
    above = package[: len(package) - node.level + 1]
    return ".".join((*above, *([node.module] if node.module else [])))


def imports(path: Path) -> set[str]:
    """Every module of tools/ that one imports, those that only mypy reads too."""
    found = set()
    for node in ast.walk(trees()[path]):
        if isinstance(node, ast.ImportFrom) and (start := base(node, path)) is not None:
            for alias in node.names:
                inside = f"{start}.{alias.name}".lstrip(".")
                found.add(inside if inside in MODULES else start)
    return found


def strangers(path: Path) -> set[str]:
    """Packages that are not ours."""
    found = set()
    for node in ast.walk(trees()[path]):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found.add((node.module or "").partition(".")[0])
    return found


@cache
def all_imports() -> dict[str, set[str]]:
    return {name: imports(path) for name, path in MODULES.items()}


def room(module: str) -> str:
    return module.partition(".")[0]


def may_import(module: str, used: str) -> bool:
    if used in GROUND or room(used) == room(module):
        return True
    return room(used) in ROOMS.get(room(module), ())


def test_every_module_has_a_room() -> None:
    assert {room(module) for module in MODULES} - set(GROUND) == set(ROOMS)


def test_a_module_imports_only_from_lower_rooms() -> None:
    unknown = {name: used - MODULES.keys() for name, used in all_imports().items()}
    assert not any(unknown.values()), {name: used for name, used in unknown.items() if used}
    refused = {
        module: wrong
        for module, names in all_imports().items()
        if (wrong := sorted(used for used in names if not may_import(module, used)))
    }
    assert not refused


def test_a_room_imports_only_what_is_lower() -> None:
    assert not circles({name: set(lower) for name, lower in ROOMS.items()})


def test_a_room_uses_all_that_it_may() -> None:
    used = {name: set() for name in ROOMS}
    for module, others in all_imports().items():
        if room(module) in used:
            used[room(module)] |= {room(other) for other in others} - {room(module), *GROUND}
    allowed = {name: set(lower) for name, lower in ROOMS.items() if name != "cli"}
    assert {name: used[name] for name in allowed} == allowed


def test_no_import_leads_back_to_where_it_began() -> None:
    assert not circles(all_imports()), "these import one another, or one that does"


def test_a_room_says_what_it_is_for_and_what_it_may_import() -> None:
    for name, lower in ROOMS.items():
        words = ast.get_docstring(trees()[TOOLS / name / "__init__.py"])
        assert words and words.partition("\n\n")[2], f"{name}: what for, and who is imported"
        if name != "cli":  # which imports all of them
            last = words.rpartition("\n\n")[2]
            assert {other for other in ROOMS if re.search(rf"`{other}`", last)} == set(lower), name


def test_only_commands_know_the_screen() -> None:
    others = [name for name in MODULES if room(name) not in SCREENS and name not in SCREENS]
    assert not [name for name in others if strangers(MODULES[name]).intersection(SCREEN)]


def writes(path: Path) -> bool:
    """Whether a module opens files for writing; what is said to a board's Python is text."""
    for node in ast.walk(trees()[path]):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            modes = [one.value for one in node.args if isinstance(one, ast.Constant)]
            opens = node.func.attr == "open" and any(mode in ("w", "wb", "xb") for mode in modes)
            if opens or node.func.attr in _WRITING:
                return True
    return False


def test_files_are_written_by_one_function_that_leaves_no_half_ones() -> None:
    on_board = TOOLS / "device" / "selftest" / "on_board"
    found = {name for name, path in MODULES.items() if on_board not in path.parents}
    assert {name for name in found if writes(MODULES[name])} == WRITERS


def test_functions_and_files_stay_short() -> None:
    assert not too_long(trees())
