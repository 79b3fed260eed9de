"""Modules and the scopes in them, for bundle.py: what a name means where it stands."""

import ast
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from typing import NamedTuple

from . import scan

_Import = ast.Import | ast.ImportFrom
_Scope = (ast.FunctionDef, ast.Lambda, ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
_Comprehension = ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp


class Meaning(NamedTuple):
    """A name of a module; the module itself without one; a name of Python without a module."""

    module: str
    name: str


class NotUnderstood(Exception):
    """Why modules cannot be written into one, in a sentence."""


# The compiler's own, imported or not.
CONST = Meaning("micropython", "const")


class Names(NamedTuple):
    """Names of a module: what imports make, what else it makes, constants of these; what hides
    global names somewhere, and what stands alone."""

    imports: dict[str, Meaning]
    own: dict[str, None]
    constants: frozenset[str]
    inner: frozenset[str]
    words: frozenset[str]


class Module:
    """A module, without what only mypy reads. It is written in the unit of that name."""

    def __init__(self, name: str, text: str, unit: str) -> None:
        self.name = name
        self.unit = unit
        self._text = text
        self.imports, self.own, self.constants, self.inner, self.words = _names(name, text)

    def tree(self) -> ast.Module:
        """Its statements but for imports, for the caller to change."""
        return ast.Module([part for part in ast.parse(self._text).body if _is_kept(part)], [])


def _is_kept(statement: ast.stmt) -> bool:
    return not (isinstance(statement, _Import) or _is_for_us(statement))


@lru_cache(1024)
def _names(module: str, text: str) -> Names:
    """The same module is part of many boards."""
    imports: dict[str, Meaning] = {}
    tree = ast.Module([], [])
    for statement in ast.parse(text).body:
        if isinstance(statement, _Import):
            imports.update(_imported(module, statement))
        elif _is_kept(statement):
            _check(module, statement)
            tree.body.append(statement)
    own = dict.fromkeys(_bound(tree))
    inner, words = frozenset(_inner(tree)), frozenset(_words(tree))
    return Names(imports, own, frozenset(scan.constants(tree)), inner, words)


def _check(module: str, statement: ast.stmt) -> None:
    if isinstance(statement, ast.FunctionDef | ast.ClassDef):
        return
    if any(isinstance(node, _Import) for node in scan.walk(statement)):
        raise NotUnderstood(f"{module}: an import is part of another statement")


def _is_for_us(statement: ast.stmt) -> bool:
    """Whether only people or mypy read it."""
    match statement:
        case ast.If(ast.Name(name), orelse=[]) | ast.Assign([ast.Name(name)]):
            return name in ("TYPE_CHECKING", "_TYPE_CHECKING")
        case ast.Expr(ast.Constant()):
            return True
    return False


def _imported(here: str, node: _Import) -> dict[str, Meaning]:
    """What the names that an import makes stand for, as it says."""
    found = {}
    for alias in node.names:
        name = alias.asname or alias.name
        if isinstance(node, ast.Import):
            found[name] = Meaning(alias.name, "")
        else:
            found[name] = Meaning(node.module or "", alias.name)
        if "." in name or name == "*" or (isinstance(node, ast.ImportFrom) and node.level):
            raise NotUnderstood(f"{here}: {ast.unparse(node)} says no name or no module")
    return found


def _bound(node: ast.AST) -> Iterator[str]:
    """Names that are made something in the scope of a node, but not in those within."""
    for child in scan.children(node):
        if isinstance(child, ast.FunctionDef | ast.ClassDef):
            yield child.name
        elif not isinstance(child, _Scope):
            match child:
                case ast.Name(name, ast.Store() | ast.Del()) | ast.ExceptHandler(name=str(name)):
                    yield name
                case ast.Import() | ast.ImportFrom():
                    yield from scan.imports(child)
            yield from _bound(child)


def local_names(node: ast.AST) -> set[str]:
    """Names of the scope that a function or the like makes."""
    match node:
        case ast.FunctionDef() | ast.Lambda():
            arguments = (part.arg for part in scan.walk(node.args) if isinstance(part, ast.arg))
            return {*_bound(node), *arguments}
        case ast.ListComp() | ast.SetComp() | ast.DictComp() | ast.GeneratorExp():
            return {name for part in node.generators for name in _bound(part)}
    return set()


def _inner(tree: ast.AST) -> Iterator[str]:
    """Names that hide global ones somewhere; those of methods do so from decorators alone."""
    for node in scan.walk(tree):
        yield from scan.fields(node) if isinstance(node, ast.ClassDef) else local_names(node)


def _words(tree: ast.AST) -> Iterator[str]:
    """Names that stand alone, which MicroPython's compiler takes for constants of that name."""
    for node in scan.walk(tree):
        match node:
            case ast.Name(name) | ast.arg(name) | ast.keyword(arg=str(name)):
                yield name


class Ours:
    """All modules of a program, by name."""

    def __init__(self, modules: Mapping[str, Module]) -> None:
        self.modules = modules

    def __contains__(self, meaning: Meaning) -> bool:
        """Whether it is a module of ours."""
        return not meaning.name and meaning.module in self.modules

    def means(self, module: Module, name: str) -> Meaning:
        """What a global name of a module stands for."""
        if name in module.own:
            return Meaning(module.name, name)
        return self.source(module.imports.get(name, Meaning("", name)))

    def source(self, meaning: Meaning) -> Meaning:
        """Where that is made: through all modules that only import it, too."""
        whole = f"{meaning.module}.{meaning.name}"
        if whole in self.modules:
            return Meaning(whole, "")
        if meaning == CONST:
            return Meaning("", "const")
        module = self.modules.get(meaning.module)
        if module is None or not meaning.name or meaning.name in module.own:
            return meaning
        if meaning.name not in module.imports:
            raise NotUnderstood(f"there is no {meaning.name} in {meaning.module}")
        return self.source(module.imports[meaning.name])


# The name of what is meant, in the module that is written. here: as it is called in the module
# that asks; "" where it is asked of its module.
Find = Callable[[Meaning, str], str]


class Rewriter(ast.NodeTransformer):
    """Gives what is global in a module the names that find() has for it. there: the name that
    something has in the module that it is written in."""

    def __init__(
        self, ours: Ours, module: Module, find: Find, there: Callable[[Meaning], str]
    ) -> None:
        self._ours = ours
        self._module = module
        self._find = find
        self._there = there
        self._local: set[str] = set()
        self._fields: set[str] = set()  # of the class whose body this is
        self._aliases: dict[str, Meaning] = {}  # of modules, local too

    def _refusal(self, node: ast.AST, what: str) -> NotUnderstood:
        return NotUnderstood(f"{self._module.name}: {what}: {ast.unparse(node)[:60]}")

    # Names

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id in self._aliases:
            raise self._refusal(node, "a module is used otherwise than by asking it for a name")
        return ast.Name(self._name(node, node.id), node.ctx)

    def _name(self, node: ast.AST, name: str) -> str:
        if name in self._local:
            return name
        if name in self._fields:
            if (
                isinstance(node, ast.Name)
                and isinstance(node.ctx, ast.Load)
                and self._is_global(name)
            ):
                raise self._refusal(node, "a class and its module have this name")
            return name
        meaning = self._ours.means(self._module, name)
        if meaning in self._ours:
            raise self._refusal(node, "a module is used otherwise than by asking it for a name")
        return self._seen(node, self._find(meaning, name), name)

    def _is_global(self, name: str) -> bool:
        return name in self._module.own or name in self._module.imports

    def _seen(self, node: ast.AST, new: str, old: str) -> str:
        if new != old and new in self._local | self._fields:
            raise self._refusal(node, f"{new} would be another one here")
        return new

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        if not isinstance(node.value, ast.Name):
            return ast.Attribute(self.visit(node.value), node.attr, node.ctx)
        name = node.value.id
        hidden = name in self._local | self._fields
        module = self._aliases.get(name) or (
            Meaning("", name) if hidden else self._ours.means(self._module, name)
        )
        if module not in self._ours:
            return ast.Attribute(self.visit(node.value), node.attr, node.ctx)
        if not isinstance(node.ctx, ast.Load):
            raise self._refusal(node, "a name of another module is changed")
        meaning = self._ours.source(Meaning(module.module, node.attr))
        if name in self._aliases:
            return ast.Attribute(node.value, self._there(meaning), node.ctx)
        return ast.Name(self._seen(node, self._find(meaning, ""), ""), node.ctx)

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        """A text that is nothing but names of modules names those that are written."""
        if not isinstance(node.value, str):
            return node
        modules = [self._ours.modules.get(word) for word in node.value.split(" ")]
        units = dict.fromkeys(module.unit for module in modules if module)
        return node if None in modules else ast.Constant(" ".join(units))

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> ast.AST:
        if node.name:
            node.name = self._name(node, node.name)
        return self.generic_visit(node)

    def visit_Global(self, node: ast.Global) -> ast.stmt:
        raise self._refusal(node, "a function changes what is global")

    def visit_Expr(self, node: ast.Expr) -> ast.stmt:
        """A module that is written in this one goes with it, and not before."""
        for name in scan.named_in_calls(node, scan.FORGET):
            module = self._ours.modules.get(name)
            if module and module.unit == self._module.unit:
                return ast.Pass()
        return ast.Expr(self.visit(node.value))

    # Imports of functions

    def visit_Import(self, node: ast.Import) -> ast.stmt:
        if any(meaning in self._ours for meaning in _imported(self._module.name, node).values()):
            raise self._refusal(node, "say `from PACKAGE import MODULE`")
        return node

    def visit_ImportFrom(self, node: ast.ImportFrom) -> list[ast.stmt]:
        made: list[ast.stmt] = []
        for name, said in _imported(self._module.name, node).items():
            meaning = self._ours.source(said)
            module = self._ours.modules.get(meaning.module)
            if module is None or (meaning in self._ours and module.unit == module.name):
                made.append(ast.ImportFrom(said.module, [_alias(said.name, name)], 0))
            elif meaning in self._ours:
                made.append(ast.Import([_alias(module.unit, name)]))
            else:
                made.append(ast.ImportFrom(module.unit, [_alias(self._there(meaning), name)], 0))
        return made

    # Scopes

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.stmt:
        node.name = self._name(node, node.name)
        node.decorator_list = [self.visit(each) for each in node.decorator_list]
        node.returns = self.visit(node.returns) if node.returns else None
        self.visit(node.args)
        with self._inside(node):
            node.body = self._visited(node.body)
        return node

    def visit_Lambda(self, node: ast.Lambda) -> ast.expr:
        self.visit(node.args)
        with self._inside(node):
            node.body = self.visit(node.body)
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.stmt:
        node.name = self._name(node, node.name)
        node.decorator_list = [self.visit(each) for each in node.decorator_list]
        node.bases = [self.visit(each) for each in node.bases]
        node.keywords = [self.visit(each) for each in node.keywords]
        fields, self._fields = self._fields, set(_bound(ast.Module(node.body, [])))
        node.body = self._visited(node.body)
        self._fields = fields
        return node

    def _comprehension(self, node: _Comprehension) -> ast.AST:
        first = node.generators[0]
        outside, first.iter = self.visit(first.iter), ast.Constant(None)
        with self._inside(node):
            self.generic_visit(node)
        first.iter = outside
        return node

    visit_ListComp = visit_SetComp = visit_DictComp = visit_GeneratorExp = _comprehension

    @contextmanager
    def _inside(self, node: ast.AST) -> Iterator[None]:
        """In the scope that a node makes."""
        before = self._local, self._fields, self._aliases
        names = local_names(node)
        self._local, self._fields = self._local | names, set()
        self._aliases = {n: m for n, m in self._aliases.items() if n not in names}
        for part in scan.walk(node):
            if isinstance(part, ast.ImportFrom):
                found = _imported(self._module.name, part)
                sources = {name: self._ours.source(said) for name, said in found.items()}
                self._aliases.update((n, m) for n, m in sources.items() if m in self._ours)
        yield
        self._local, self._fields, self._aliases = before

    def _visited(self, body: list[ast.stmt]) -> list[ast.stmt]:
        made: list[ast.stmt] = []
        for statement in body:
            new = self.visit(statement)
            made += new if isinstance(new, list) else [new]
        return made


def _alias(name: str, here: str) -> ast.alias:
    return ast.alias(name, None if name == here else here)
