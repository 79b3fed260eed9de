"""Marks in the firmware's sources that say what a name is, where the code alone does not.

    self.active = 0  # keep-name: esp32.RMT has active(), too

keeps the name of an attribute as it is, for the reason given. And

    _ROWS = (  # attribute-names: column 1

says that this column of the table, or of the dictionary's values, that begins there has names of
attributes: they are changed with these.

    MAKER = "_make_"  # keep-prefix: parts.py looks for methods by it

keeps all methods that begin so. And above a viper function,

    # inline: always, for it runs several times for each segment

puts it in the place of its calls however large it is, "never" however small; see leaves.py.
Comments are read before the first pass, for not every pass keeps them; so a table is known by its
variable.
"""

import ast
import re
from collections.abc import Iterator, Mapping
from typing import NamedTuple

_KEEP = re.compile(r"^\s*(?:self\.)?(\w+)\s*[:=].*#\s*keep-name:\s*(\S.*)$", re.MULTILINE)
_COLUMN = re.compile(r"[({\[]\s*#\s*attribute-names: column (\d+)$")
_PREFIX = re.compile(r'^\w+ = "(\w+)"\s*#\s*keep-prefix:\s*(\S.*)$', re.MULTILINE)
_INLINE = re.compile(
    r"^# inline: (always|never), \S.*\n(?:# .*\n)*@micropython\.viper\ndef (\w+)", re.MULTILINE
)
_ANY = re.compile(r"#\s*(?:keep-name|keep-prefix|attribute-names|inline):")

# A function by its module.
Key = tuple[str, str]

_Container = ast.Tuple | ast.List | ast.Dict


class Table(NamedTuple):
    """Where it is: within which of its variable's elements, by their numbers."""

    module: str
    variable: str
    path: tuple[int, ...]


class Marks(NamedTuple):
    """kept, prefixes: why each stays; tables: which column has names; inline: by function."""

    kept: dict[str, str]
    tables: dict[Table, int]
    prefixes: dict[str, str]
    inline: dict[Key, str]


def none() -> Marks:
    """Where nothing is marked."""
    return Marks({}, {}, {}, {})


def read(sources: Mapping[str, str]) -> Marks:
    """All marks of these modules. ValueError where one is not written as it should be."""
    marks = none()
    for module, text in sources.items():
        if not _ANY.search(text):
            continue
        found = Marks(
            dict(_KEEP.findall(text)),
            dict(_tables(module, text)),
            dict(_PREFIX.findall(text)),
            {(module, function): how for how, function in _INLINE.findall(text)},
        )
        understood = len(found.kept) + len(found.tables) + len(found.prefixes) + len(found.inline)
        if len(_ANY.findall(text)) != understood:
            raise ValueError(f"{module}: a mark that compiling/marks.py does not understand")
        marks.kept.update(found.kept)
        marks.tables.update(found.tables)
        marks.prefixes.update(found.prefixes)
        marks.inline.update(found.inline)
    return marks


def cells(module: str, tree: ast.Module, marks: Marks) -> Iterator[ast.expr]:
    """Every cell of a module's marked tables."""
    for rows, _ in _marked(module, tree, marks):
        for row in rows:
            yield from row.elts


def names(module: str, tree: ast.Module, marks: Marks) -> Iterator[tuple[ast.expr, str]]:
    """Those of its cells that are names of attributes."""
    for rows, column in _marked(module, tree, marks):
        for row in rows:
            match row.elts[column : column + 1]:
                case [ast.Constant(str(name)) as cell]:
                    yield cell, name


def _marked(module: str, tree: ast.Module, marks: Marks) -> Iterator[tuple[list[ast.Tuple], int]]:
    variables = dict(_variables(tree)) if any(t.module == module for t in marks.tables) else {}
    for table, column in marks.tables.items():
        if table.module == module and table.variable in variables:
            node = variables[table.variable]
            for number in table.path:
                node = _elements(node)[number]
            yield [row for row in _elements(node) if isinstance(row, ast.Tuple)], column


def _tables(module: str, text: str) -> Iterator[tuple[Table, int]]:
    tree = ast.parse(text)
    for line, content in enumerate(text.splitlines(), 1):
        found = _COLUMN.search(content)
        if found:
            column = len(content[: found.start()].encode())
            for variable, value in _variables(tree):
                for path in _paths(value, line, column):
                    yield Table(module, variable, path), int(found[1])


def _variables(tree: ast.Module) -> Iterator[tuple[str, ast.expr]]:
    """Values of a module's variables, and of its classes': `Class.NAME`."""
    for statement in tree.body:
        inside = statement.body if isinstance(statement, ast.ClassDef) else [statement]
        prefix = f"{statement.name}." if isinstance(statement, ast.ClassDef) else ""
        for part in inside:
            match part:
                case ast.Assign([ast.Name(name)], value):
                    yield prefix + name, value
                case ast.AnnAssign(ast.Name(name), value=ast.expr() as value):
                    yield prefix + name, value


def _paths(node: ast.expr, line: int, column: int) -> Iterator[tuple[int, ...]]:
    """Where in a value the container is that begins at this place."""
    if isinstance(node, _Container) and (node.lineno, node.col_offset) == (line, column):
        yield ()
    for number, part in enumerate(_elements(node)):
        yield from ((number, *path) for path in _paths(part, line, column))


def _elements(node: ast.expr) -> list[ast.expr]:
    if isinstance(node, ast.Dict):
        return node.values
    return node.elts if isinstance(node, ast.Tuple | ast.List) else []
