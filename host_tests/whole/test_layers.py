"""The house rules of firmware/: layers look down, hardware stays in ports, files stay short."""

import ast
import re
import sys
from collections import Counter
from functools import cache
from pathlib import Path

FIRMWARE = Path(__file__).parents[2] / "firmware"

# Folders are layers: who may import what of which others, what only mypy reads included. In its
# own folder a module may import what does not lead back to it. main.py only starts.
LAYERS: "dict[str, tuple[str, ...]]" = {
    "base": (),
    "motion": ("base",),
    "control": ("base", "motion"),
    "language": ("base", "motion", "control"),
    "talk": ("base", "motion", "control", "language"),
    "extras": ("base", "motion", "control", "language", "talk"),
    "ports": ("base", "motion"),
    "pio": ("base", "motion", "ports"),
    "esp_chip": ("base", "motion", "ports"),
    "ugrbl_motion": ("base", "motion", "ports", "pio", "esp_chip"),
}
LAYERS["boot"] = tuple(LAYERS)
LAYERS["main"] = ("boot",)
PORTS = ("ports", "pio", "esp_chip")
LIBRARY_PINS = "ugrbl_motion.hardware"  # the pins of programs that have no port
# Protocols that mypy knows, and what they are made of: never on a board.
SEAMS = "interfaces"

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


def module_name(path):
    return ".".join(path.relative_to(FIRMWARE).with_suffix("").parts)


def imports(tree):
    """Yield the name of every imported module, including imports for mypy only."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            # `from folder import a` imports the module folder.a, `from module import a` the
            # module.
            assert node.level == 0, "no relative imports: a stranger is to see the folder"
            parent = FIRMWARE / node.module.replace(".", "/")
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from names if parent.is_dir() else [node.module]


@cache
def trees():
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in FILES}


@cache
def all_imports():
    return {module_name(path): set(imports(tree)) for path, tree in trees().items()}


def typing_only(used):
    return used in ("typing", "types", "collections.abc", SEAMS)


def may_import(module, used):
    """Return whether a module of firmware/ may import another one. LAYERS: a folder's lower
    ones."""
    folder, used_folder = module.partition(".")[0], used.partition(".")[0]
    if typing_only(used) or folder == used_folder:
        return True
    if used == BOARD_FILE:
        return folder == "boot"
    if used_folder in LAYERS:
        return used_folder in LAYERS[folder]
    return used in MICROPYTHON and (
        used not in HARDWARE or folder in PORTS or module == LIBRARY_PINS
    )


def test_every_folder_has_a_place_in_the_layers():
    assert {module.partition(".")[0] for module in all_imports()} == set(LAYERS)


def test_a_module_imports_only_from_lower_layers():
    """refused: by module, the imports that may_import() does not allow."""
    refused = {
        module: wrong
        for module, names in all_imports().items()
        if (wrong := sorted(used for used in names if not may_import(module, used)))
    }
    assert not refused


def modules_on_cycles(imports):
    """Return the modules on circles of imports, and those that import them.

    Modules that import none of those left are removed, again and again, until there are none.
    imports: the modules that each one uses.
    """
    remaining = {module: used & imports.keys() for module, used in imports.items()}
    while ends := [module for module, used in remaining.items() if not used & remaining.keys()]:
        for module in ends:
            del remaining[module]
    return remaining


def test_no_import_leads_back_to_where_it_began():
    assert not modules_on_cycles(all_imports()), "these import one another, or one that does"


def test_a_circle_is_found():
    assert set(modules_on_cycles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": set()})) == {
        "a",
        "b",
        "c",
    }


def test_no_name_hides_a_module_of_either_python():
    taken = MICROPYTHON | {f"u{name}" for name in EXTENSIBLE.split()} | sys.stdlib_module_names
    names = {name for path in FILES for name in (path.relative_to(FIRMWARE).parts[0], path.stem)}
    assert not names & taken


def test_no_two_kernels_have_the_same_name():
    """The build puts all kernels of a board's core into one module."""
    count = Counter(
        node.name
        for tree in trees().values()
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
        and "micropython.viper" in map(ast.unparse, node.decorator_list)
    )
    assert count.total() > 150 and count.most_common(1)[0][1] == 1


def line_count(node):
    return node.end_lineno - node.lineno + 1


def too_long(trees, tables=False):
    """Return functions of more than 60 lines and files of more than 400, with their lines.

    trees: a parsed tree by path. tables: lines of tables at the top level do not count.
    """
    lines_of = {}
    for path, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and line_count(node) > 60:
                lines_of[f"{path}: {node.name}"] = line_count(node)
        table_lines = (
            line_count(node)
            for node in tree.body
            if isinstance(node, (ast.Assign, ast.AnnAssign))
            and isinstance(node.value, (ast.Tuple, ast.Dict, ast.List))
        )
        lines = len(path.read_text(encoding="utf-8").splitlines()) - (
            sum(table_lines) if tables else 0
        )
        if lines > 400:
            lines_of[str(path)] = lines
    return lines_of


def test_no_method_is_put_in_the_place_of_another():
    """Extras come in by base/hooks.py."""
    assert [file for file in FILES if "method-assign" in file.read_text(encoding="utf-8")] == []


def test_no_two_modules_have_one_name():
    """Except the chips' modules named pins: a board has one of them, with the same methods."""
    names = Counter(path.stem for path in FILES if path.stem not in ("__init__", "pins"))
    assert [name for name, count in names.items() if count > 1] == []


def test_nothing_is_made_of_more_than_six_others():
    """A class that needs more objects than six gets the whole machine instead.

    Counted are the parameters of __init__() and connect(), without self.
    """
    parameters = {
        f"{module_name(path)}: {class_.name}": len(method.args.args) - 1
        for path, tree in trees().items()
        for class_ in ast.walk(tree)
        if isinstance(class_, ast.ClassDef)
        for method in class_.body
        if isinstance(method, ast.FunctionDef) and method.name in ("__init__", "connect")
    }
    assert parameters, "there are constructors"
    assert {name: count for name, count in parameters.items() if count > 6} == {}


CORE = ("base", "motion", "control", "language", "talk")
# What is an extra's, wherever it stands in a name, a comment or a text.
_EXTRA_WORDS = (
    r"jerk|cluster|\bdots?\b|_dots|rotary|punch|\bjobs?\b|custom|backlash|dialect|skew|ganged|"
    r"lenient|tmc2209|drain|nonlinear|joint|scara|drilling|upload"
)
# Modules of extras, and folders, called by words that the core needs itself: Grbl's (kinematics of
# a CoreXY, laser mode, a cycle), the board's, and everyday ones.
_SHARED = "__init__ api cycles events handlers kinematics laser motors net positions tools".split()


def words_of_extras():
    """Return a pattern for words of extras: _EXTRA_WORDS, and names of modules and folders.

    _SHARED: names that the core uses in another sense; each must still be an extra's.
    """
    paths = [path.relative_to(FIRMWARE / "extras") for path in FILES if "extras" in path.parts]
    names = {part.removesuffix(".py") for path in paths for part in path.parts}
    assert set(_SHARED) <= names, "_SHARED has a name that no extra has any more"
    own_names = r"|".join(sorted(map(re.escape, names - set(_SHARED))))
    return re.compile(f"{_EXTRA_WORDS}|{own_names}", re.IGNORECASE)


def test_the_core_has_never_heard_of_an_extra():
    """No file of the core contains a word of an extra, in code or comments."""
    words = words_of_extras()
    words_in_file = {
        str(file.relative_to(FIRMWARE)): hits
        for file in FILES
        if module_name(file).split(".")[0] in CORE
        and (hits := words.findall(file.read_text(encoding="utf-8")))
    }
    assert not words_in_file


def test_words_of_extras_are_found_in_names_comments_and_texts():
    words = words_of_extras()
    for line in ("FIRST_DOT = 1  # jobs", "import job_run", "MOST_DOTS", "JerkPlan", '"a Custom"'):
        assert words.search(line), line
    assert not words.search("the adjoining place of an arc's chords; nobody's jobbing")


def test_functions_and_files_stay_short():
    assert not too_long(trees(), tables=True)


def test_no_tool_hides_a_folder_beside_it():
    """Both are on the path of a replay, and a module wins over a folder without __init__.py."""
    tools = FIRMWARE.parent / "tools"
    assert not [name for name in ("boards", "firmware") if (tools / f"{name}.py").exists()]


# Who makes text of bytes: what is no text raises there, wherever it comes from.
# A sender's; what a checksum has vouched for.
DECODES = {"base.text": 1, "ports.storage.flash_store": 1}


def decodings(tree):
    """Yield the nodes that make text of bytes: x.decode(), str(x, …), open() of a text file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr == "decode":
            yield node
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            mode = ast.unparse(node.args[1]) if len(node.args) > 1 else ""
            if (node.func.id == "str" and len(node.args) + len(node.keywords) > 1) or (
                node.func.id == "open" and "b" not in mode
            ):
                yield node


def test_bytes_become_text_in_one_place():
    counts = {module_name(path): len(list(decodings(tree))) for path, tree in trees().items()}
    assert {module: count for module, count in counts.items() if count} == DECODES


def test_whatever_makes_text_of_bytes_is_found():
    text = "x.decode()\nstr(x, 'utf-8')\nopen(x)\nopen(x, 'w')\nf = x.decode\n"
    assert len(list(decodings(ast.parse(text)))) == 5
    assert not list(decodings(ast.parse("open(x, 'rb')\nstr(x)\nx.open(y)\n")))
