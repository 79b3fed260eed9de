"""The user's own Python, custom.py or a folder of such files, on this computer.

It is read once, and compiled to check its syntax. On the board its name is that of the board's
option CUSTOM. The simulator imports it under the same name from these sources: no file is written
next to it, and a file called math.py hides no other module.
"""

import ast
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from .. import paths
from ..grbl.gcode_file import NotText, check_utf8

NAME = "custom"  # name on the board, unless its file has another
# Methods that take the name of a pin, and the name of a tuple of such names.
OUTPUT_CALLS, OUTPUT_NAMES = ("out", "pwm", "servo"), "OUTPUTS"
INPUT_CALLS, INPUT_NAMES = ("pin", "wait_for", "input"), "INPUTS"


class OwnPythonError(ValueError):
    """It cannot be read or compiled, or fails when imported; the text has file, line and cause."""


class LackError(OwnPythonError):
    """It needs something that boards have, and the simulator does not."""


@dataclass(frozen=True)
class Module:
    """One file."""

    file: Path
    source: bytes
    tree: ast.Module = field(compare=False, repr=False)


@dataclass(frozen=True)
class OwnPython:
    """A file, or a folder of them. modules: by the name for import."""

    path: Path
    name: str
    modules: "dict[str, Module]"

    @property
    def is_folder(self) -> bool:
        """Return whether it has several files, which may import each other."""
        return self.name not in self.modules

    @property
    def files(self) -> "dict[str, bytes]":
        """Return the files for the board, by path."""
        return {
            f"{name.replace('.', '/')}.py": module.source for name, module in self.modules.items()
        }

    def has_attribute(self, name: str) -> bool:
        """Return whether an attribute of that name is read or written anywhere: `m.keep`."""
        return any(
            isinstance(node, ast.Attribute) and node.attr == name
            for module in self.modules.values()
            for node in ast.walk(module.tree)
        )

    def outputs(self) -> "Iterator[tuple[Module, int, str]]":
        """Yield names of outputs with their module and line."""
        yield from self._strings_given_to(*OUTPUT_CALLS)
        yield from self._strings_in(OUTPUT_NAMES)

    def inputs(self) -> "Iterator[tuple[Module, int, str]]":
        """Yield names of inputs with their module and line."""
        yield from self._strings_given_to(*INPUT_CALLS)
        yield from self._strings_in(INPUT_NAMES)

    def _strings_in(self, name: str) -> "Iterator[tuple[Module, int, str]]":
        """Yield the strings, with module and line, in a tuple of that name at the top of a module:
        `OUTPUTS = ("air", "lamp")`."""
        for module in self.modules.values():
            for node in module.tree.body:
                if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple):
                    if any(isinstance(to, ast.Name) and to.id == name for to in node.targets):
                        for each in node.value.elts:
                            if isinstance(each, ast.Constant) and isinstance(each.value, str):
                                yield module, each.lineno, each.value

    def _strings_given_to(self, *methods: str) -> "Iterator[tuple[Module, int, str]]":
        """Yield the strings, with module and line, that are the first argument in calls of these
        methods: `m.out("vacuum", 1)`."""
        for module in self.modules.values():
            for node in ast.walk(module.tree):
                if (
                    isinstance(node, ast.Call)
                    and isinstance(node.func, ast.Attribute)
                    and node.func.attr in methods
                    and node.args
                    and isinstance(node.args[0], ast.Constant)
                    and isinstance(node.args[0].value, str)
                ):
                    yield module, node.lineno, node.args[0].value


def read(path: Path, name: str = NAME) -> OwnPython:
    """Read and compile the file or folder. OwnPythonError, with one sentence, if that fails."""
    if path.is_dir():
        files = sorted(file for file in path.glob("*.py") if file.name[0] != ".")
        if not files:
            raise OwnPythonError(f"{path}: there is no .py file in this folder")
        if path / "__init__.py" in files:
            raise OwnPythonError(
                f"{path / '__init__.py'}: remove it; in a folder of handlers, the board reads "
                "each file by itself"
            )
        return OwnPython(path, name, {f"{name}.{file.stem}": _module(file) for file in files})
    if path.suffix != ".py":
        why = "is no Python file: the name of one ends in .py" if path.exists() else "is not there"
        raise OwnPythonError(f"{path} {why}")
    return OwnPython(path, name, {name: _module(path)})


def _module(file: Path) -> Module:
    """Read and compile one file. OwnPythonError if that fails."""
    try:
        source = file.read_bytes()
    except OSError as error:
        raise OwnPythonError(f"{file} cannot be read: {paths.why(error)}") from error
    return Module(file, source, _compiled(file, source))


def _compiled(file: Path, source: bytes) -> ast.Module:
    """Return the syntax tree of a file that CPython can compile; else OwnPythonError, with the
    line."""
    try:
        check_utf8(source, file)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # "\d" is for the author's editor to report
            compile(source, str(file), "exec", dont_inherit=True)
            return ast.parse(source, str(file))
    except SyntaxError as error:
        line = f", line {error.lineno}" if error.lineno else ""
        shown = f": {error.text.strip()}" if error.text and error.text.strip() else ""
        raise OwnPythonError(f"{file}{line}: {error.msg}{shown}") from error
    except NotText as error:
        raise OwnPythonError(str(error)) from error
