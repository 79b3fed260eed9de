"""Modules of the firmware, and what the names in them mean: for leaves.py."""

import ast
from collections.abc import Iterator

from . import forms
from .marks import Key


class Module:
    """A module, and what its names mean."""

    def __init__(self, name: str, text: str) -> None:
        self.name = name
        self.changed = False
        self.tree = ast.parse(text)
        self.functions = {f.name: f for f in forms.vipers(self.tree, methods=False)}
        self.imported: dict[str, Key] = {}
        self.taken = {n.id for n in ast.walk(self.tree) if isinstance(n, ast.Name)}
        self.aliases: dict[str, str] = {}  # of modules
        numbers = {n: forms.literal(v) for n, v in forms.constants(self.tree).items()}
        for function in forms.vipers(self.tree, methods=True):
            hidden = forms.local_names(function)
            here = {n: v for n, v in numbers.items() if n not in hidden}
            function.body = forms.renamed(function.body, here)
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                self.aliases.update((n.asname or n.name, n.name) for n in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module:
                for n in node.names:
                    self.imported[n.asname or n.name] = (node.module, n.name)
                    self.aliases[n.asname or n.name] = f"{node.module}.{n.name}"

    def means(self, name: str) -> Key | None:
        """The function that a global name may stand for."""
        return (self.name, name) if name in self.functions else self.imported.get(name)

    def uses(self) -> Iterator[Key]:
        """All that is mentioned, once per mention, imports left out."""
        yield from self._uses(self.tree, set())

    def _uses(self, node: ast.AST, hidden: set[str]) -> Iterator[Key]:
        for child in ast.iter_child_nodes(node):
            match child:
                case ast.Name(name, ast.Load()) if name not in hidden:
                    if meant := self.means(name):
                        yield meant
                case ast.Attribute(ast.Name(alias), name):
                    yield self.aliases.get(alias, ""), name
            if isinstance(child, ast.FunctionDef):
                yield from self._uses(child, hidden | forms.local_names(child))
            else:
                yield from self._uses(child, hidden)

    def import_too(self, name: str, key: Key) -> None:
        """Import a function under this name, behind the other imports."""
        found = [i for i, s in enumerate(self.tree.body) if isinstance(s, ast.ImportFrom)]
        alias = ast.alias(key[1], None if name == key[1] else name)
        self.tree.body.insert(found[-1] + 1, ast.ImportFrom(key[0], [alias], 0))
        self.imported[name] = key

    def drop(self, gone: set[Key]) -> None:
        """Do without these functions."""
        dropped = [self.functions[name] for module, name in gone if module == self.name]
        if dropped:
            self.tree.body = [s for s in self.tree.body if s not in dropped]
            self.changed = True
        _Imports(self, gone).visit(self.tree)


class _Imports(ast.NodeTransformer):
    """Takes names out of imports."""

    def __init__(self, module: Module, gone: set[Key]) -> None:
        self._module = module
        self._gone = gone

    def visit_ImportFrom(self, node: ast.ImportFrom) -> ast.stmt:
        left = [n for n in node.names if (node.module, n.name) not in self._gone]
        if len(left) == len(node.names):
            return node
        self._module.changed = True
        node.names = left
        return node if left else ast.Pass()
