"""The packages of tools/: each imports only from lower ones, there is no cycle, all stays
short."""

import ast
import re
from functools import cache
from pathlib import Path

from test_layers import modules_on_cycles, too_long

TOOLS = Path(__file__).parents[2] / "tools"

# Allowed imports of each package, including those for mypy only. All may import paths.
PACKAGES: "dict[str, tuple[str, ...]]" = {
    "grbl": (),
    "sim": (),
    "boardfile": ("grbl", "sim"),
    "compiling": ("boardfile",),
    "run": ("grbl", "sim", "boardfile", "compiling"),
    "draw": ("grbl", "sim", "boardfile", "run"),
    "replay": ("boardfile", "compiling"),
    "device": ("grbl", "boardfile", "compiling", "run"),
    "image": ("boardfile", "compiling", "run", "device"),
    "web": ("grbl", "sim", "boardfile", "run", "draw", "device"),
    "docs": ("grbl", "sim", "boardfile", "run", "replay"),
}
PACKAGES["cli"] = tuple(PACKAGES)
GROUND = ("", "paths")  # the package itself, for its version
# Modules for terminals and exit. `make docs` is a command, too; kernels asks typer for the user's
# folder.
SCREEN = ("typer", "rich", "prompt_toolkit")
SCREENS = ("cli", "docs.__main__", "run.kernels")

# Modules that write without paths.write(): into a temporary or new folder, a disk's image, or our
# docs.
WRITERS = {
    "run.kernels",
    "compiling.machine_code",
    "boardfile.page_files",
    "docs.__main__",
    "image.file_system",
    "paths",
}
_WRITING = ("write_text", "write_bytes")

# Modules that replace a board's under CPython: not a package, see test_stubs.py.
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
    """Return a module's name, `draw.page`; a package's own name; "" for the whole."""
    parts = path.relative_to(TOOLS).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in FILES}


def base(node: ast.ImportFrom, path: Path) -> "str | None":
    """Return the module or package of tools/ that something is imported from, like "sim.rig".

    None for foreign ones. node.level: the number of dots, as in `from ..sim import rig`.
    """
    if not node.level:
        assert not re.match(r"(ugrbl|tools)\b", node.module or ""), "import it from . or .."
        return None
    package = path.relative_to(TOOLS).parent.parts
    above = package[: len(package) - node.level + 1]
    return ".".join((*above, *([node.module] if node.module else [])))


def imports(path: Path) -> set[str]:
    """Return every module of tools/ that a file imports, including imports for mypy only."""
    names = set()
    for node in ast.walk(trees()[path]):
        if isinstance(node, ast.ImportFrom) and (source := base(node, path)) is not None:
            for alias in node.names:
                # `from .folder import a` imports the module folder.a, if there is one.
                member = f"{source}.{alias.name}".lstrip(".")
                names.add(member if member in MODULES else source)
    return names


def foreign_imports(path: Path) -> set[str]:
    """Return the foreign packages that a file imports."""
    names = set()
    for node in ast.walk(trees()[path]):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names.add((node.module or "").partition(".")[0])
    return names


@cache
def all_imports() -> dict[str, set[str]]:
    return {name: imports(path) for name, path in MODULES.items()}


def package_of(module: str) -> str:
    return module.partition(".")[0]


def may_import(module: str, used: str) -> bool:
    if used in GROUND or package_of(used) == package_of(module):
        return True
    return package_of(used) in PACKAGES.get(package_of(module), ())


def test_every_module_is_in_a_package() -> None:
    assert {package_of(module) for module in MODULES} - set(GROUND) == set(PACKAGES)


def test_a_module_imports_only_from_lower_packages() -> None:
    """Every import is a module of tools/, and may_import() allows it; refused: by module."""
    unknown = {name: used - MODULES.keys() for name, used in all_imports().items()}
    assert not any(unknown.values()), {name: used for name, used in unknown.items() if used}
    refused = {
        module: wrong
        for module, names in all_imports().items()
        if (wrong := sorted(used for used in names if not may_import(module, used)))
    }
    assert not refused


def test_a_package_imports_only_lower_packages() -> None:
    assert not modules_on_cycles({name: set(lower) for name, lower in PACKAGES.items()})


def test_a_package_uses_all_its_allowed_imports() -> None:
    """PACKAGES: the packages that each package may import; it must import all of them.

    cli is left out: it may import all.
    """
    used = {name: set() for name in PACKAGES}
    for module, others in all_imports().items():
        if package_of(module) in used:
            used[package_of(module)] |= {package_of(other) for other in others} - {
                package_of(module),
                *GROUND,
            }
    allowed = {name: set(lower) for name, lower in PACKAGES.items() if name != "cli"}
    assert {name: used[name] for name in allowed} == allowed


def test_imports_have_no_cycle() -> None:
    assert not modules_on_cycles(all_imports()), "these import one another, or one that does"


def test_a_package_documents_its_purpose_and_its_imports() -> None:
    """Its docstring has several paragraphs; the last one names the packages as `name`."""
    for name, lower in PACKAGES.items():
        docstring = ast.get_docstring(trees()[TOOLS / name / "__init__.py"])
        assert docstring and docstring.partition("\n\n")[2], f"{name}: purpose and imports"
        if name != "cli":  # which imports all of them
            last_paragraph = docstring.rpartition("\n\n")[2]
            assert {
                other for other in PACKAGES if re.search(rf"`{other}`", last_paragraph)
            } == set(lower), name


def test_only_commands_use_the_screen() -> None:
    others = [name for name in MODULES if package_of(name) not in SCREENS and name not in SCREENS]
    assert not [name for name in others if foreign_imports(MODULES[name]).intersection(SCREEN)]


def writes(path: Path) -> bool:
    """Return whether a module writes files: open() with such a mode, or write_text().

    Code that it sends to a board's Python is a text in it, and is not found.
    """
    for node in ast.walk(trees()[path]):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            modes = [one.value for one in node.args if isinstance(one, ast.Constant)]
            opens = node.func.attr == "open" and any(mode in ("w", "wb", "xb") for mode in modes)
            if opens or node.func.attr in _WRITING:
                return True
    return False


def test_only_the_atomic_writer_writes_files() -> None:
    on_board = TOOLS / "device" / "selftest" / "on_board"
    names = {name for name, path in MODULES.items() if on_board not in path.parents}
    assert {name for name in names if writes(MODULES[name])} == WRITERS


def test_functions_and_files_stay_short() -> None:
    assert not too_long(trees())
