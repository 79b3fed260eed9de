"""Names that nobody outside sees become short ones, before the firmware is compiled.

A board keeps every name of the code it loads, text and all, in memory: 7 bytes and its letters.
The first names in MicroPython's own ROM have a fixed place in every .mpy file, whatever the board,
and cost neither memory nor a search at start. So attributes, private methods, parameters and
private variables of modules take such names instead, where the sources do not use them. Names of
public functions, of classes and of modules stay: whoever talks to a board's objects has those.

Where it is not plain that a name is ours alone it stays as it is: what Python's objects have too,
what getattr() asks for or is passed by keyword, what a board file says. Where the code does not
say it a mark does (marks.py), and a text that could be a name and is not marked is an error. No
line moves, and the sources do the same without it.
"""

import array
import ast
import builtins
import io
import types
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import cache
from typing import NamedTuple

from . import marks as mk
from . import scan
from .marks import Marks
from .short_names import SHORT

# Names no longer than this gain nothing, and a block has its words by their letters.
_LETTERS = 2

_PARAMETERS = 24  # of these names are for parameters, which hide variables of modules

_Function = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda
_OTHER_CODE = ("viper", "asm_pio")  # whose parameters cost nothing, or are no variables


class _Edit(NamedTuple):
    """A name in place of another, at a line (from 1) and a byte of it."""

    line: int
    column: int
    old: str
    new: str


class Shortened(NamedTuple):
    """The modules, by name, and what became of their names.

    names: the short name of what any module may ask another for, by the long one. The other way
    round, by the short name: attributes and variables in each module, attributes of each class.
    id: what tells this firmware from others.
    """

    texts: dict[str, str]
    names: dict[str, str]
    attributes: dict[str, dict[str, list[str]]]
    variables: dict[str, dict[str, list[str]]]
    classes: dict[str, dict[str, str]]
    id: str = ""


def shorten(sources: Mapping[str, str], marks: Marks | None = None) -> Shortened:
    """The modules, by name, with short names in place. ValueError where a mark is missing."""
    marks = marks or mk.read(sources)
    trees = {name: ast.parse(text) for name, text in sources.items()}
    survey = _Survey(trees, marks)
    attributes, shared = survey.attributes(), survey.shared()
    names = {**attributes, **shared}
    _check_texts(trees, marks, attributes)
    left = [name for name in survey.free[_PARAMETERS:] if name not in shared.values()]
    stay = survey.kept | survey.asked
    asked = {name: [*_name_edits(name, tree, names, marks)] for name, tree in trees.items()}
    own = {
        name: [
            *_parameter_edits(tree, survey.keywords, survey.free[:_PARAMETERS]),
            *_uses([tree], shared),
            *_variable_edits(tree, stay, left),
            *_constant_edits(tree, stay),
        ]
        for name, tree in trees.items()
    }
    return Shortened(
        {name: _apply(text, asked[name] + own[name]) for name, text in sources.items()},
        names,
        {name: _by_short(edits) for name, edits in asked.items()},
        {name: _by_short(edits) for name, edits in own.items()},
        survey.classes(attributes),
    )


def follow(module: str, text: str, made: Shortened) -> str:
    """The source of one who uses the firmware's objects, by the public names these have now.

    What its own classes have goes by the same names, for the firmware may use them.
    """
    tree = ast.parse(text)
    public = {name: short for name, short in made.names.items() if name[0] != "_"}
    edits = [*_name_edits(module, tree, public, mk.none())]
    edits += _uses([tree], {n: public[n] for n in scan.imports(tree) if n in public})
    for node in scan.walk(tree):
        if isinstance(node, ast.keyword) and node.arg in public:
            edits.append(_Edit(node.lineno, node.col_offset, node.arg, public[node.arg]))
        for part in node.body if isinstance(node, ast.ClassDef) else ():
            if isinstance(part, ast.FunctionDef) and part.name in public:
                at = part.col_offset + len("def ")
                edits.append(_Edit(part.lineno, at, part.name, public[part.name]))
    return _apply(text, edits)


def _by_short(edits: "Iterable[_Edit]") -> dict[str, list[str]]:
    found: dict[str, set[str]] = defaultdict(set)
    for edit in edits:
        found[edit.new].add(edit.old)
    return {short: sorted(long) for short, long in sorted(found.items())}


def _check_texts(
    trees: Mapping[str, ast.Module], marks: Marks, attributes: Mapping[str, str]
) -> None:
    """ValueError where a text is what an attribute was called, and no mark says what it is."""
    for module, tree in trees.items():
        marked = set(mk.cells(module, tree, marks))
        for text in scan.texts(tree):
            if text.value in attributes and text not in marked:
                raise ValueError(
                    f"{module}: is {text.value!r} the name of an attribute? If so, mark its table "
                    "(attribute-names), else the attribute (keep-name): compiling/marks.py"
                )


# What there is


class _Survey:
    """Every name of all modules, and what it is."""

    def __init__(self, trees: Mapping[str, ast.Module], marks: Marks) -> None:
        self.keywords = set(marks.kept)
        self.asked: set[str] = set()  # what modules are asked for
        self.kept = {*marks.kept, *_python()}
        self._named: set[str] = set()  # functions, classes, modules
        self._imported: set[str] = set()
        self._public: set[str] = set()  # variables of modules
        self._foreign: set[str] = set()  # what modules that are not here are asked for
        self._stored: set[str] = set()
        self._alone: dict[str, set[str]] = defaultdict(set)  # classes that say self.name
        self._private: set[ast.FunctionDef] = set()  # methods that only their class calls
        self._common: set[str] = set()  # in modules that most boards have
        self._common_attributes: set[str] = set()  # attributes in those
        self._seen: set[str] = set()  # attributes of something else than self
        self._inner: set[str] = set()
        self._bases: dict[str, set[str]] = defaultdict(set)
        self._families: dict[str, str] = {}
        self._modules = {part for name in trees for part in (name, name.partition(".")[0])}
        used = set(marks.kept)
        for module, tree in trees.items():
            self.kept |= set(scan.asked_by_text(tree))
            self._named |= set(module.split("."))
            self._imported |= set(scan.imports(tree))
            self._public |= set(scan.public(tree))
            self._inner |= set(scan.inside(tree))
            classes = (node for node in scan.walk(tree) if isinstance(node, ast.ClassDef))
            self._private |= {m for c in classes for m in scan.private_methods(c, marks.prefixes)}
            identifiers = Counter(scan.identifiers(tree))
            if scan.is_common(module):
                self._common |= identifiers.keys()
                self._common_attributes |= set(scan.attributes(tree))
            else:  # nothing of ours is called so where a stranger's module is asked for it
                identifiers -= Counter(scan.asked_of_strangers(tree, self._modules))
            used |= identifiers.keys()
            self._read(tree, self._aliases(tree), "")
            for _, name in mk.names(module, tree, marks):
                self._stored.add(name)
                self._alone[name] |= set()
                self._seen.add(name)
        self.free = [name for name in SHORT if name not in used | self.kept - _python()]

    def _aliases(self, tree: ast.Module) -> dict[str, bool]:
        """What a module calls others, and whether these are here."""
        found = {}
        for node in scan.walk(tree):
            if isinstance(node, ast.Import):
                for alias in node.names:
                    whole = alias.name in self._modules
                    found[alias.asname or alias.name.partition(".")[0]] = whole
            elif isinstance(node, ast.ImportFrom):
                here = node.module in self._modules
                found.update((alias.asname or alias.name, here) for alias in node.names)
                names = {alias.name for alias in node.names}
                self.asked |= names
                self._foreign |= set() if here else names
        return found

    def _read(self, node: ast.AST, modules: Mapping[str, bool], inside: str) -> None:
        match node:
            case ast.ClassDef():
                inside = node.name
                self._named.add(node.name)
                self._bases[inside] |= {ast.unparse(base) for base in node.bases}
                methods = [m.name for m in ast.iter_child_nodes(node) if m in self._private]
                for name in (*scan.fields(node), *methods):
                    self._stored.add(name)
                    self._alone[name].add(inside)
                self.kept |= scan.loaded(node)
            case ast.FunctionDef() if node in self._private:
                pass
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                self._named.add(node.name)
            case ast.keyword(arg=str(name)):
                self.keywords.add(name)
            case ast.Attribute(value, name, context):
                self._attribute(value, name, modules, inside)
                if isinstance(context, ast.Store):
                    self._stored.add(name)
        for child in ast.iter_child_nodes(node):
            self._read(child, modules, inside)

    def _attribute(
        self, value: ast.expr, name: str, modules: Mapping[str, bool], inside: str
    ) -> None:
        root = scan.root(value)
        if inside and ast.unparse(value) in ("self", "super()"):
            self._alone[name].add(inside)
        elif root in modules:
            self.asked.add(name)
            if not (isinstance(value, ast.Name) and modules[root]):
                self._foreign.add(name)
        else:
            self._seen.add(name)

    def shared(self) -> dict[str, str]:
        """The short name of each variable, in capitals, that modules have for one another."""
        names = self._public & self.asked - self.kept - self._foreign - self._inner - self._seen
        names -= {*self._alone, *self._named}
        capitals = [name for name in names if name == name.upper() and len(name) > _LETTERS]
        capitals.sort(key=lambda name: (name not in self._common, name))
        return dict(zip(capitals, self.free[: _PARAMETERS - 1 : -1]))

    def attributes(self) -> dict[str, str]:
        """The short name of each. Two share one where no object has both."""
        foreign = {self._family(name) for name, bases in self._bases.items() if self._odd(bases)}
        other = {*self.kept, *self.asked, *self._public, *self._named, *self._imported}
        homes = {
            name: {self._family(kind) for kind in self._alone[name]}
            for name in self._stored & self._alone.keys() - other
            if _is_plain(name)
        }
        homes = {name: kinds for name, kinds in homes.items() if not kinds & foreign}
        found: dict[str, str] = {}
        taken: dict[str, set[str]] = defaultdict(set)
        everywhere = set(self._bases) | {self._family(kind) for kind in self._bases}
        # Those that every board has first, of these such as may be of any object, then by how much
        # there is to gain. Among equals any order would do; in this one a collection of garbage on
        # a Pico happens not to run out of MicroPython's 64 places, which makes it 21 ms for 11.
        for name in sorted(
            homes,
            key=lambda n: (
                n not in self._common_attributes,
                n not in self._seen,
                -len(homes[n]),
                n[::-1],
            ),
        ):
            kinds = everywhere if name in self._seen else homes[name]
            short = next((s for s in self.free if not any(s in taken[k] for k in kinds)), None)
            if short:
                found[name] = short
                for kind in kinds:
                    taken[kind].add(short)
        return found

    def classes(self, attributes: Mapping[str, str]) -> dict[str, dict[str, str]]:
        """The long names of each class's attributes by their short ones."""
        found: dict[str, dict[str, str]] = {}
        for kind in self._bases:
            family = self._family(kind)
            own = [n for n in attributes if family in {self._family(k) for k in self._alone[n]}]
            found[kind] = {attributes[name]: name for name in sorted(own)}
        return found

    def _odd(self, bases: set[str]) -> bool:
        """Whether a class has a base that is not here."""
        return any(base not in self._bases for base in bases)

    def _family(self, kind: str) -> str:
        """A name for all classes that are kin to this one: the first of them."""
        if kind not in self._families:
            kin: set[str] = set()
            more = {kind}
            while not more <= kin:
                kin |= more
                more = {k for k, bases in self._bases.items() if k in kin or bases & kin}
                more |= {base for k in kin for base in self._bases.get(k, ())}
            self._families |= dict.fromkeys(kin, min(kin))
        return self._families[kind]


def _is_plain(name: str) -> bool:
    return len(name) > _LETTERS and not name.startswith("__")


@cache
def _python() -> frozenset[str]:
    """Names of what Python's own objects have."""
    kinds = [kind for kind in vars(builtins).values() if isinstance(kind, type)]
    kinds += [array.array, io.StringIO, io.FileIO, type(_python), types.GeneratorType]
    names = {name for kind in kinds for name in dir(kind)}
    return frozenset(name for name in names if name[0] != "_" or name[:2] == "__")


# What becomes of it


def _name_edits(
    module: str, tree: ast.Module, short: Mapping[str, str], marks: Marks
) -> Iterator[_Edit]:
    """Attributes, and what is imported from other modules."""
    for text, name in mk.names(module, tree, marks):
        if name in short:
            yield _Edit(text.lineno, text.col_offset + 1, name, short[name])
    for node in scan.walk(tree):
        match node:
            case ast.ImportFrom():
                for alias in node.names:
                    if alias.name in short:
                        yield _Edit(alias.lineno, alias.col_offset, alias.name, short[alias.name])
            case ast.Attribute(_, name) if name in short:
                column = (node.end_col_offset or 0) - len(name.encode())
                yield _Edit(node.end_lineno or 0, column, name, short[name])
            case ast.ClassDef():
                for method in scan.private_methods(node, marks.prefixes):
                    if method.name in short:
                        column = method.col_offset + len("def ")
                        yield _Edit(method.lineno, column, method.name, short[method.name])
                for statement in node.body:
                    match statement:
                        case ast.Assign([ast.Name(name) as at]) if name in short:
                            yield _edit(at, name, short[name])
                        case ast.AnnAssign(ast.Name(name) as at) if name in short:
                            yield _edit(at, name, short[name])


def _edit(node: ast.expr | ast.arg, old: str, new: str) -> _Edit:
    return _Edit(node.lineno, node.col_offset, old, new)


def _parameter_edits(
    node: ast.AST, kept: set[str], free: list[str], since: int = 0
) -> Iterator[_Edit]:
    """Parameters, by their place; those of a function within one take the names that follow."""
    if isinstance(node, _Function) and not _is_other_code(node):
        body = node.body if isinstance(node.body, list) else [node.body]
        again = {name for part in body for name in scan.inner(part)}
        arguments = [arg for arg in node.args.args if arg.arg not in ("self", "cls")]
        pairs = [pair for pair in zip(arguments, free[since:]) if pair[0].arg not in kept | again]
        for arg, short in pairs:
            yield _edit(arg, arg.arg, short)
        yield from _uses(body, {arg.arg: short for arg, short in pairs})
        since += len(arguments)
    for child in ast.iter_child_nodes(node):
        yield from _parameter_edits(child, kept, free, since)


def _is_other_code(node: _Function) -> bool:
    if isinstance(node, ast.Lambda):
        return False
    return any(word in ast.unparse(d) for d in node.decorator_list for word in _OTHER_CODE)


def _uses(trees: Iterable[ast.AST], short: Mapping[str, str]) -> Iterator[_Edit]:
    for tree in trees if short else ():
        for node in scan.walk(tree):
            if isinstance(node, ast.Name) and node.id in short:
                yield _edit(node, node.id, short[node.id])


def _variable_edits(tree: ast.Module, kept: Collection[str], free: list[str]) -> Iterator[_Edit]:
    """Private variables of a module, but for constants, which the compiler puts in place."""
    found = {name for name in scan.variables(tree) if name[0] == "_" and name[:2] != "__"}
    found -= {*scan.inside(tree), *kept, *scan.constants(tree)}
    yield from _uses([tree], dict(zip(sorted(found), free)))


def _constant_edits(tree: ast.Module, kept: Collection[str]) -> Iterator[_Edit]:
    """Constants that nobody else asks for are private: the compiler does not store such."""
    there = set(scan.identifiers(tree))
    names = {name for name in scan.constants(tree) if name[0] != "_" and "_" + name not in there}
    yield from _uses([tree], {name: "_" + name for name in names - set(kept)})


def _apply(text: str, edits: Iterable[_Edit]) -> str:
    """Replace from the end on, so that places stay true."""
    lines = [line.encode() for line in text.splitlines(keepends=True)]
    for line, column, old, new in sorted(set(edits), reverse=True):
        whole, end = lines[line - 1], column + len(old.encode())
        assert whole[column:end] == old.encode(), f"{old} is not in {whole!r}"
        lines[line - 1] = whole[:column] + new.encode() + whole[end:]
    return b"".join(lines).decode()
