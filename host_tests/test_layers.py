"""The house rules of firmware/: layers look down, hardware stays in ports, files stay short."""

import ast
import sys
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).parent.parent / "firmware"

# A module imports from lower lines only, never from its own. A new module gets its place here.
LAYERS = (
    {"errors", "axes", "f32", "reals", "needs"},
    {"words", "lines", "arcs", "digits", "kernels"},
    {"state", "settings", "coords", "singles", "saves"},
    {"block", "planner", "segments", "spindle", "coolant", "inputs"},
    {"checks", "motion", "report"},
    {"plain", "cycles", "report_09", "overrides"},
    {"gcode"},
    {"realtime", "commands", "suspension"},
    {"protocol", "punch"},
    {"controller"},
    {"wiring"},
    {"parts_esp"},
    {"parts"},
    {"power_up"},
    {"main"},
)
LAYER = {module: number for number, layer in enumerate(LAYERS) for module in layer}

# Ports stand outside the stack: they use the two lowest layers and their own kind, and only
# what makes a board's parts uses them.
BOOT = ("parts", "parts_esp")
PORT_PREFIXES = ("link", "gpio", "store", "supervisor")
PORT_FOLDERS = ("pio", "esp_chip")
PORT_LAYERS = (0, 1)

HARDWARE = {"esp", "esp32", "machine", "os", "rp2", "select", "vfs"}
# What MicroPython 1.28 has built in on rp2 and esp32 (MP_REGISTER_MODULE, py and extmod included),
# what a file can extend, and what is frozen (boards/manifest.py, bundle-networking). A name of the
# first kind wins over any file or folder; no file of ours has any of these names.
BUILT_IN = (
    "__main__ _asyncio _espnow _onewire _rp2 _thread _webrepl btree builtins cmath deflate esp "
    "esp32 framebuf gc lwip marshal math micropython network openamp sys tls uctypes vfs "
    "weakref"
)
EXTENSIBLE = (
    "array binascii bluetooth collections cryptolib errno hashlib heapq io json machine os "
    "platform random re select socket string struct time websocket"
)
FROZEN = (
    "_boot _boot_fat aioble aioespnow apa106 asyncio dht ds18x20 espflash espnow flashbdev "
    "inisetup logging mip neopixel ntptime onewire requests rp2 sdcard senml ssl umqtt upysh "
    "urequests webrepl webrepl_setup"
)
MICROPYTHON = set(f"{BUILT_IN} {EXTENSIBLE} {FROZEN}".split())
BOARD_FILE = "board"  # a file of boards/, put beside main.py on the board

FILES = sorted(FIRMWARE.rglob("*.py"))
each_file = pytest.mark.parametrize(
    "path", FILES, ids=[str(path.relative_to(FIRMWARE)) for path in FILES]
)


def module_name(path):
    return ".".join(path.relative_to(FIRMWARE).with_suffix("").parts)


def is_port(module):
    top = module.partition(".")[0]
    return top in PORT_FOLDERS or top.startswith(PORT_PREFIXES)


def kind(module):
    """What ports have in common: their folder, or how their names begin."""
    top = module.partition(".")[0]
    return top if top in PORT_FOLDERS else top.partition("_")[0]


def imports(tree):
    """Yield every imported module, also inside functions, but not what only mypy reads."""
    if isinstance(tree, ast.If) and ast.unparse(tree.test).endswith("TYPE_CHECKING"):
        for node in tree.orelse:
            yield from imports(node)
    elif isinstance(tree, ast.Import):
        yield from (alias.name for alias in tree.names)
    elif isinstance(tree, ast.ImportFrom):
        assert tree.level == 0, "the firmware is flat: no relative imports"
        parent = FIRMWARE / tree.module.replace(".", "/")
        names = [f"{tree.module}.{alias.name}" for alias in tree.names]
        yield from names if parent.is_dir() else [tree.module]
    else:
        for node in ast.iter_child_nodes(tree):
            yield from imports(node)


def may_import(module, used):
    if used in MICROPYTHON:
        return used not in HARDWARE or is_port(module)
    if is_port(module):
        return kind(used) == kind(module) or LAYER.get(used) in PORT_LAYERS
    if is_port(used) or used == BOARD_FILE:
        return module in BOOT
    return LAYER.get(used, len(LAYERS)) < LAYER[module]


@each_file
def test_a_module_imports_only_from_lower_layers(path):
    module = module_name(path)
    assert is_port(module) or module in LAYER, f"give {module} a place in LAYERS, in {__file__}"
    used = set(imports(ast.parse(path.read_text())))
    refused = sorted(name for name in used if not may_import(module, name))
    assert not refused, f"{module} may not import {', '.join(refused)}"


@each_file
def test_no_name_hides_a_module_of_either_python(path):
    taken = MICROPYTHON | {f"u{name}" for name in EXTENSIBLE.split()} | sys.stdlib_module_names
    hidden = taken.intersection({path.relative_to(FIRMWARE).parts[0], path.stem})
    assert not hidden, f"{path} hides, or is hidden by, the module {hidden}"


def length(node):
    return node.end_lineno - node.lineno + 1


@each_file
def test_functions_and_files_stay_short(path):
    text = path.read_text()
    tree = ast.parse(text)
    functions = (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))
    long = {f"{node.name}: {length(node)} lines" for node in functions if length(node) > 60}
    assert not long, f"functions have 60 lines at most: {long}"
    tables = (
        length(node)
        for node in tree.body
        if isinstance(node, (ast.Assign, ast.AnnAssign))
        and isinstance(node.value, (ast.Tuple, ast.Dict, ast.List))
    )
    lines = len(text.splitlines()) - sum(tables)
    # A viper sees constants of its own module only, so the kernels stay in one.
    most = 900 if path.stem == "kernels" else 400
    assert lines <= most, f"{lines} lines; a module has {most} at most, tables not counted"


@pytest.mark.parametrize("folder", ["boards", "firmware"])
def test_no_tool_hides_a_folder_beside_it(folder):
    """Both are on the path of a replay, and a module wins over a folder without __init__.py."""
    assert not (FIRMWARE.parent / "tools" / f"{folder}.py").exists()
