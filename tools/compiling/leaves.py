"""Viper functions put in place of their calls, before the firmware is compiled.

A viper function that calls another pays 5 to 8 us on a Pico: the name is looked up, each argument
becomes an object and a number again. So leaves are written short, to be read, and here they are
put where they are called; those without a call left go. The sources mean the same without it.

Put in place are calls that stand alone, `f(x)`, and those in `int(f(x))`: of a function that has
no other call, of a small one, and of one that a mark says so of (marks.py). A call stays where
evaluation would change its order or happen without need, and where the function would have to
return out of a loop.

What becomes of the names in a leaf: a parameter is its argument, where that is a number or a local
of the same type; each other local is called `int__0`, by its type, and by `leaf__name` where that
cannot be told. Such a name has one type wherever it appears, as viper wants it, so calls one after
the other can share it: every local takes a place on a stack of 8 kB.
"""

import ast
import copy
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import count

from . import forms
from . import marks as mk
from .marks import Key, Marks
from .modules import Module

# Nodes of a syntax tree that are worth their room at every call. A call takes about 50 bytes; 60
# nodes in its place 250. On a Pico: 34 in place of 40 saves 1 kB, and costs 15 us a line.
_SMALL = 34
# Types of locals that may share a name.
_SHARED = {"int", *forms.POINTERS}


def leaves(sources: Mapping[str, str], marks: Marks | None = None) -> dict[str, str]:
    """The modules, by name, with viper functions in place of their calls."""
    program = _Program(sources, marks or mk.read(sources))
    program.put_all()
    program.clear()
    return {
        name: ast.unparse(ast.fix_missing_locations(module.tree)) if module.changed else text
        for (name, text), module in zip(sources.items(), program.modules.values())
    }


class _Program:
    """All modules, and which of their functions are put in place."""

    def __init__(self, sources: Mapping[str, str], marks: Marks) -> None:
        self._marked = marks.inline
        self.modules = {name: Module(name, text) for name, text in sources.items()}
        self.placed: set[Key] = set()
        self._leaves = {
            (module.name, name)
            for module in self.modules.values()
            for name, function in module.functions.items()
            if forms.is_leaf(function)
        }
        self._mentions = Counter(key for module in self.modules.values() for key in module.uses())
        self._names = Counter(name for _, name in self._leaves)
        self._done: set[Key] = set()
        self._open: set[Key] = set()  # they contain the one being changed

    def put_all(self) -> None:
        """Put leaves in place everywhere."""
        for module in self.modules.values():
            for name in module.functions:
                self.function((module.name, name))
            for function in forms.vipers(module.tree, methods=True):
                if module.functions.get(function.name) is not function:
                    _Caller(self, module, function).change()

    def function(self, key: Key) -> ast.FunctionDef:
        """A function with leaves in place."""
        module = self.modules[key[0]]
        if key not in self._done:
            self._open.add(key)
            _Caller(self, module, module.functions[key[1]]).change()
            self._open.discard(key)
            self._done.add(key)
        return module.functions[key[1]]

    def is_leaf(self, key: "Key | None") -> bool:
        """Whether this is a function that could be put in place."""
        return key in self._leaves and key not in self._open

    def is_wanted(self, key: Key) -> bool:
        """Whether it is worth its room."""
        if key in self._marked:
            return self._marked[key] == "always"
        return self._mentions[key] == 1 or forms.size(self.function(key)) <= _SMALL

    def prefix(self, key: Key) -> str:
        """How the names of a leaf's locals begin."""
        module, name = key
        return name if self._names[name] == 1 else f"{module.replace('.', '_')}_{name}"

    def clear(self) -> None:
        """Drop what has no call left, and imports in vain."""
        modules = self.modules.values()
        gone = self.placed
        while gone:
            used = {key for module in modules for key in module.uses()}
            gone = self.placed - used
            for module in modules:
                module.drop(gone)
            self.placed -= gone
        for module in modules:
            used = set(module.uses())
            module.drop({key for key in self.placed - used if key[0] != module.name})


@dataclass
class _Place:
    """A statement that calls are taken out of."""

    before: list[ast.stmt] = field(default_factory=list)
    touched: bool = False  # something evaluated before has looked at memory, or changed it


class _Caller:
    """A function in which calls are replaced."""

    def __init__(self, program: _Program, module: Module, function: ast.FunctionDef) -> None:
        self._program = program
        self._module = module
        self._function = function
        self._types = forms.types(function)
        self._locals = forms.local_names(function)
        self._is_int = forms.annotation(function.returns) == "int"
        self._live: list[str] = []  # names that may not be shared for now

    def change(self) -> None:
        """Replace all that can be."""
        if forms.is_plain(self._function):
            self._function.body = self._block(self._function.body)

    def _block(self, statements: "list[ast.stmt]") -> "list[ast.stmt]":
        made: list[ast.stmt] = []
        for statement in statements:
            made += self._statement(self._branched(statement))
        return made or [ast.Pass()]

    def _branched(self, statement: ast.stmt) -> ast.stmt:
        """`x = f() if c else g()` as an `if`: only one of them is to be evaluated."""
        choice = getattr(statement, "value", None)
        target = getattr(statement, "target", None)
        if not isinstance(choice, ast.IfExp) or isinstance(target, ast.Subscript):
            return statement
        parts = [choice.body, choice.orelse]
        if not any(self._call_in(node) for part in parts for node in ast.walk(part)):
            return statement
        halves = [copy.deepcopy(statement), copy.deepcopy(statement)]
        for half, part in zip(halves, parts):
            vars(half)["value"] = part
        return ast.If(choice.test, halves[:1], halves[1:])

    def _statement(self, statement: ast.stmt) -> "list[ast.stmt]":
        call, end = self._only_call(statement)
        if call:
            return self._put(call, end)
        place, pending = _Place(), len(self._live)
        self._take_out(statement, place)
        del self._live[pending:]
        if isinstance(statement, ast.If | ast.For | ast.While | ast.Try):
            for part in (statement, *getattr(statement, "handlers", ())):
                part.body = self._block(part.body)
            statement.orelse = self._block(statement.orelse) if statement.orelse else []
        return [*place.before, statement]

    def _only_call(self, statement: ast.stmt) -> "tuple[ast.Call | None, forms.End | None]":
        """The call that a statement consists of, and what to do with its result."""
        match statement:
            case ast.Expr(ast.Call() as call) if self._can_go(call):
                return call, _drop
            case ast.Assign([ast.Name(name)], value):
                return self._call_in(value), partial(_store, name)
            case ast.Return(ast.expr() as value) if self._is_int:
                return self._call_in(value, tail=True), None
        return None, None

    def _take_out(self, statement: ast.stmt, place: _Place) -> None:
        """Of the expressions that it begins with, in the order of their evaluation."""
        match statement:
            case ast.Assign(targets, value):
                statement.value = self._without(value, place)
                statement.targets = [self._without(target, place) for target in targets]
            case ast.AugAssign(target=target, value=value):
                if isinstance(target, ast.Subscript):
                    statement.target = target = copy.copy(target)
                    target.slice = self._without(target.slice, place)
                    place.touched = True
                statement.value = self._without(value, place)
            case ast.Expr(value) | ast.Return(ast.expr() as value):
                statement.value = self._without(value, place)
            case ast.If(test):
                statement.test = self._without(test, place)
            case ast.For(_, source):
                statement.iter = self._without(source, place)

    def _without(self, node: ast.expr, place: _Place, certain: bool = True) -> ast.expr:
        """An expression without its calls of leaves; these go before the statement."""
        call = self._call_in(node) if certain else None
        if call and (not place.touched or self._is_pure(call)):
            name = self._fresh(self._key(call), "result", "int")
            place.before += self._put(call, partial(_store, name))
            self._live.append(name)
            return ast.Name(name, ast.Load())
        first = True
        for field_name, value in ast.iter_fields(node):
            many = value if isinstance(value, list) else [value]
            for number, part in enumerate(many):
                if isinstance(part, ast.expr):
                    skipped = not first and isinstance(node, ast.BoolOp | ast.IfExp)
                    skipped = skipped or (isinstance(node, ast.Compare) and number > 0)
                    many[number] = self._without(part, place, certain and not skipped)
                    first = False
            setattr(node, field_name, value if isinstance(value, list) else many[0])
        place.touched = place.touched or forms.touches(node)
        return node

    def _call_in(self, node: ast.AST, tail: bool = False) -> "ast.Call | None":
        """The call in `int(f(x))`, if f can be put in its place."""
        match node:
            case ast.Call(ast.Name("int"), [ast.Call() as call]) if self._can_go(call, tail):
                return call
        return None

    def _key(self, call: ast.Call) -> Key:
        """The function that is called, if it is a leaf."""
        if isinstance(call.func, ast.Name) and call.func.id not in self._locals:
            key = self._module.means(call.func.id)
            if key and self._program.is_leaf(key):
                return key
        return ("", "")

    def _can_go(self, call: ast.Call, tail: bool = False) -> bool:
        """Whether a call can be replaced. tail: what it returns is returned."""
        key = self._key(call)
        if not key[1] or not self._program.is_wanted(key):
            return False
        leaf = self._program.function(key)
        try:
            if not tail:
                forms.ending(leaf.body, _drop)
            self._names_for(key, leaf)
        except forms.Refused:
            return False
        return len(call.args) == len(leaf.args.args) and not call.keywords

    def _is_pure(self, call: ast.Call) -> bool:
        """Whether it does not matter when the call happens."""
        for node in ast.walk(call):
            key = self._key(node) if isinstance(node, ast.Call) else ("", "")
            pure = key[1] and forms.is_pure(self._program.function(key))
            if forms.touches(node) and not pure:
                return False
        return True

    def _put(self, call: ast.Call, end: "forms.End | None") -> "list[ast.stmt]":
        """What a call comes to. end: what to do with its result; None: return it."""
        key = self._key(call)
        leaf = self._program.function(key)
        names: dict[str, ast.expr] = self._names_for(key, leaf, add=True)
        pending = len(self._live)
        stored = forms.stored(leaf)
        made: list[ast.stmt] = []
        for parameter, value in zip(leaf.args.args, call.args):
            kind = forms.annotation(parameter.annotation)
            if parameter.arg not in stored and self._is_as_good(value, kind):
                names[parameter.arg] = value
                continue
            name = self._fresh(key, parameter.arg, kind)
            made += self._block(_store(name, self._typed(value, kind)))
            self._live.append(name)
            names[parameter.arg] = ast.Name(name, ast.Load())
        types = forms.types(leaf)
        for local in sorted(stored - names.keys()):
            self._live.append(self._fresh(key, local, types.get(local, "object")))
            names[local] = ast.Name(self._live[-1], ast.Load())
        del self._live[pending:]
        self._program.placed.add(key)
        self._module.changed = True
        body = forms.renamed(forms.body(leaf), names)
        return made + (forms.ending(body, end) if end else body)

    def _is_as_good(self, value: ast.expr, kind: str) -> bool:
        """Whether a parameter of this type needs no local."""
        match value:
            case ast.Constant(int()) | ast.UnaryOp(ast.USub(), ast.Constant(int())):
                return kind == "int"
            case ast.Name(name):
                return self._types.get(name) == kind
        return False

    def _typed(self, value: ast.expr, kind: str) -> ast.expr:
        if forms.type_of(value, self._types) == kind:
            return value
        return ast.Call(ast.Name(kind, ast.Load()), [value], [])

    def _fresh(self, key: Key, local: str, kind: str) -> str:
        """A name for a leaf's local, shared with all of its type that are not needed any more."""
        if kind in _SHARED:
            return next(n for k in count() if (n := f"{kind}{forms.MARK}{k}") not in self._live)
        name = local if forms.MARK in local else self._program.prefix(key) + forms.MARK + local
        while name in self._live:
            name += "_"
        return name

    def _names_for(
        self, key: Key, leaf: ast.FunctionDef, add: bool = False
    ) -> "dict[str, ast.expr]":
        """What a leaf's global names are called here. add: import what is not."""
        names: dict[str, ast.expr] = {}
        known = {meant: name for name, meant in self._module.imported.items()}
        for name in sorted(forms.free_names(leaf)):
            meant = self._program.modules[key[0]].means(name)
            here = known.get(meant, "") if meant else ""
            if key[0] == self._module.name:
                here = name
            elif meant and not here and name not in self._module.taken:
                here = name
                if add:
                    self._module.import_too(name, meant)
            if not here or here in self._locals:
                raise forms.Refused
            names[name] = ast.Name(here, ast.Load())
        return names


def _store(name: str, value: ast.expr) -> "list[ast.stmt]":
    return [ast.Assign([ast.Name(name, ast.Store())], value)]


def _drop(value: ast.expr) -> "list[ast.stmt]":
    return [ast.Expr(value)] if any(isinstance(n, ast.Call) for n in ast.walk(value)) else []
