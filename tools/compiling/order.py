"""The names that a module uses most come first in its table.

In MicroPython's code a name is its place in the module's table of names: one byte for the first
128, two for all others. They take their places as they are met, so a module with more names meets
those of which its functions use most in its first line, which does nothing.
"""

import ast
import keyword
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import lru_cache

from . import forms, scan, scopes

# Of those places the file's name has one, and this line's own beginning another.
_PLACES = 126
_LINE = "__name__ or __name__.{}\n"

_SHORT_TEXT = 10  # letters of a text that is a name to MicroPython


def order(sources: Mapping[str, str]) -> dict[str, str]:
    """The modules, by name, those with many names with one line more."""
    return {name: _first_line(text) + text for name, text in sources.items()}


@lru_cache(1024)
def _first_line(text: str) -> str:
    tree = ast.parse(text)
    uses = Counter(_uses(tree, set(forms.constants(tree))))
    found = sorted(uses, key=lambda name: (-uses[name], name))
    return _LINE.format(".".join(found[:_PLACES])) if len(found) > _PLACES else ""


def _uses(tree: ast.AST, hidden: set[str]) -> Iterator[str]:
    """Names in the code of functions; what is run once counts for nothing."""
    for node in scan.children(tree):
        if isinstance(node, ast.FunctionDef):
            yield node.name
            if not forms.is_viper(node):
                yield from (arg.arg for arg in node.args.args)
            inside = hidden | forms.CASTS | set(scopes.local_names(node))
            for statement in forms.body(node):
                yield from _named(statement, inside)
        else:
            yield from _uses(node, hidden)


def _named(node: ast.AST, hidden: set[str]) -> Iterator[str]:
    match node:
        case ast.Name(name) if name not in hidden:
            yield name
        case ast.Attribute(_, name) | ast.keyword(str(name)):
            yield name
        case ast.Constant(str(name)) if len(name) <= _SHORT_TEXT and _is_name(name):
            yield name
        case ast.FunctionDef():
            yield from _uses(ast.Module([node], []), hidden)
            return
        case ast.AnnAssign(target, _, value):
            yield from _named(target, hidden)
            node = ast.Expr(value) if value else ast.Pass()
        case ast.Tuple(parts) if all(isinstance(part, ast.Constant) for part in parts):
            return  # one object, whose texts are no names
    for child in scan.children(node):
        yield from _named(child, hidden)


def _is_name(text: str) -> bool:
    return text.isidentifier() and not keyword.iskeyword(text)
