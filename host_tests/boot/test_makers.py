"""Test that makers, which a board removes from memory after building, are not called later."""

import ast
from collections.abc import Iterator
from functools import cache

from boot import parts
from extras import api
from ugrbl.compiling import build

# The modules in which the machine is built. Classes apart: a stream for the prompt is not part of
# the machine; objects for handlers of custom.py, the reader of an inserted card and a browser's
# connection are created when they are needed.
BUILDING = {"boot.parts", "boot.parts_esp", "boot.wiring"}
APART = {"_Pusher", "ModalState", "Position", "SdBlocks", "WebSocket"}
# Called by extras while they are installed, and by options.py.
INSTALLING = {
    *("add_pins", "of_board", "beside", "add_cycle", "_codes", "attach"),
    *("register", "leave_out", "_add_build_info", "__getattr__"),
}


@cache
def trees() -> "dict[str, ast.Module]":
    return {name: ast.parse(text) for name, text in build.texts().items()}


@cache
def classes() -> "dict[str, set[str]]":
    """Return the base classes of each class."""
    return {
        node.name: {ast.unparse(base) for base in node.bases}
        for tree in trees().values()
        for node in tree.body
        if isinstance(node, ast.ClassDef)
    }


def is_maker(name: str) -> bool:
    return name in parts.MAKERS or parts.MAKER in name


def is_building(name: str) -> bool:
    """Return whether a function of that name runs only while the machine is built."""
    return is_maker(name) or name in INSTALLING


def is_fault(kind: str) -> bool:
    """Return whether this is an exception, or a class that is not ours."""
    return kind not in classes() or any(base == "Exception" for base in classes()[kind])


def calls_in(node: ast.AST) -> Iterator[str]:
    """Yield the name of each call in a function, except those in makers defined inside it."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef) and is_building(child.name):
            continue
        if isinstance(child, ast.Call):
            yield ast.unparse(child.func).rpartition(".")[2]
        yield from calls_in(child)


def calls_while_running() -> Iterator[tuple[str, str]]:
    """Yield (module, name) of each call that may be made after the machine is built."""
    for module, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and module not in BUILDING:
                if not is_building(node.name):
                    yield from ((module, name) for name in calls_in(node))


def test_no_maker_is_called_while_the_machine_runs() -> None:
    assert [(module, name) for module, name in calls_while_running() if is_maker(name)] == []


def test_no_extra_registers_while_the_machine_runs() -> None:
    """Methods of Cnc that register something are removed from memory, too."""
    registering = {n for n in vars(api.Cnc) if any(word in n for word in api.MAKERS)}
    assert registering  # there are some
    extras = [
        (m, n) for m, n in calls_while_running() if m.startswith("extras.") and m != "extras.api"
    ]
    assert [(module, name) for module, name in extras if name in registering] == []


def test_no_object_is_created_while_the_machine_runs() -> None:
    created = {name for _, name in calls_while_running() if not is_fault(name)}
    assert created - APART == set()
