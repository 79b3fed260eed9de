"""Names that nobody outside sees become short ones, before the firmware is compiled.

A board keeps every name of the code it loads, text and all, in memory: 7 bytes and its letters.
The first names in MicroPython's own ROM have a fixed place in every .mpy file, whatever the board,
and cost neither memory nor a search at start. So attributes, private methods, parameters and
private variables of modules take such names instead, where the sources do not use them. Names of
public functions, of classes and of modules stay: whoever talks to a board's objects has those.

Where it is not plain that a name is ours alone it stays as it is: what MicroPython's objects have
too, what is in a text (for getattr() and the like) or passed by keyword, what a board file says.
No line moves, and the sources do the same without it.
"""

import array
import ast
import builtins
import io
import types
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import cache
from typing import NamedTuple

from .. import paths
from . import scan

# Of MicroPython's static_qstr_list (py/makeqstrdata.py), part of the .mpy format 6. Not those
# that it asks an object for by itself: send, throw, close, read, write, keys, args, value; nor
# those of errors, which one would misread in a message.
SHORT = (
    "any id dir key map pop pow sep sum zip all chr ord abs end get int len set str add dict eval "
    "exec find hash iter join list next sort lower upper range print round index clear count copy "
    "bool bytes items little encode decode extend format globals insert isalpha isdigit islower "
    "isspace isupper locals lstrip rstrip strip split rsplit replace remove repr reverse rfind "
    "rindex popitem setdefault sorted update values tuple object type super property startswith "
    "endswith callable classmethod staticmethod divmod from_bytes to_bytes getattr hasattr "
    "setattr isinstance issubclass bytearray bytecode builtins append "
    # Not static, but in the ROM of every port with the usual modules: they are searched for at
    # start, and on a port without them cost what they are long.
    "acos asin atan ceil cosh erf erfc fabs fmod ldexp log2 modf sinh tanh trunc acosh asinh "
    "atanh expm1 gamma isinf isnan floor log10 lgamma degrees isclose isfinite radians deque "
    "popleft appendleft heapify heappop heappush namedtuple sha1 sha256 digest hexlify unhexlify "
    "sizeof calcsize pack_into unpack_from addressof pixel hline vline ellipse seed choice "
    "randint uniform randrange getrandbits getcwd ilistdir rmdir statvfs umount gmtime mktime "
    "localtime getter deleter discard union issubset issuperset isdisjoint difference readlines "
    "search match groups compile dumps loads scroll blit fill_rect framebuf polar factorial "
    "copysign cmath frozenset complex default a2b_base64 b2a_base64 md5 baudrate polarity "
    "firstbit mosi miso scl sda readfrom writeto readfrom_mem writeto_mem writevto memaddr "
    "write_readinto readbit writebit readbyte writebyte crc8 uname sysname nodename mkdir chdir"
).split()

# Names no longer than this gain nothing, and a block has its words by their letters.
_LETTERS = 2

# What scripts that run on the board ask us for: those of the tests and of the benchmark.
_ASKED_FOR = frozenset(("_report",))

_PARAMETERS = 24  # of these names are for parameters, which hide variables of modules

_Function = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda
_OTHER_CODE = ("viper", "asm_pio")  # whose parameters cost nothing, or are no variables


class _Edit(NamedTuple):
    """A name in place of another, at a line (from 1) and a byte of it."""

    line: int
    column: int
    old: str
    new: str


def shorten(sources: Mapping[str, str], keep: Collection[str] = ()) -> dict[str, str]:
    """The modules, by name, with short names in place. keep: names that others want too."""
    trees = {name: ast.parse(text) for name, text in sources.items()}
    survey = _Survey(trees, {*keep, *_ASKED_FOR})
    attributes, shared = survey.attributes(), survey.shared()
    left = [name for name in survey.free[_PARAMETERS:] if name not in shared.values()]
    return {
        name: _apply(
            text,
            [
                *_attribute_edits(trees[name], {**attributes, **shared}),
                *_parameter_edits(trees[name], survey.keywords, survey.free[:_PARAMETERS]),
                *_shared_edits(trees[name], shared),
                *_variable_edits(trees[name], survey.kept | survey.asked, left),
                *_constant_edits(trees[name], survey.kept | survey.asked),
            ],
        )
        for name, text in sources.items()
    }


# What there is


class _Survey:
    """Every name of all modules, and what it is."""

    def __init__(self, trees: Mapping[str, ast.Module], keep: set[str]) -> None:
        self.keywords = set(keep)
        self.asked: set[str] = set()  # what modules are asked for
        self.kept = {*keep, *_outside()}
        self._named: set[str] = set()  # functions, classes, modules
        self._imported: set[str] = set()
        self._public: set[str] = set()  # variables of modules
        self._foreign: set[str] = set()  # what modules that are not here are asked for
        self._stored: set[str] = set()
        self._alone: dict[str, set[str]] = defaultdict(set)  # classes that say self.name
        self._private: set[ast.FunctionDef] = set()  # methods that only their class calls
        self._seen: set[str] = set()  # attributes of something else than self
        self._inner: set[str] = set()
        self._bases: dict[str, set[str]] = defaultdict(set)
        self._modules = {part for name in trees for part in (name, name.partition(".")[0])}
        used = set(keep)
        for module, tree in trees.items():
            self.kept |= set(scan.texts(tree))
            self._named |= set(module.split("."))
            self._imported |= set(scan.imports(tree))
            self._public |= set(scan.public(tree))
            self._inner |= set(scan.inside(tree))
            classes = (node for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
            self._private |= {method for node in classes for method in scan.private_methods(node)}
            used |= set(scan.identifiers(tree))
            self._read(tree, self._aliases(tree), "")
        self.free = [name for name in SHORT if name not in used | self.kept - _outside()]

    def _aliases(self, tree: ast.Module) -> dict[str, bool]:
        """What a module calls others, and whether these are here."""
        found = {}
        for node in ast.walk(tree):
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
                methods = [method.name for method in scan.private_methods(node)]
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
        if isinstance(value, ast.Name) and root == "self" and inside:
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
        capitals = sorted(name for name in names if name == name.upper() and len(name) > _LETTERS)
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
        # Those that may be of any object first, then by how much there is to gain.
        for name in sorted(homes, key=lambda n: (n not in self._seen, -len(homes[n]), n)):
            kinds = everywhere if name in self._seen else homes[name]
            short = next((s for s in self.free if not any(s in taken[k] for k in kinds)), None)
            if short:
                found[name] = short
                for kind in kinds:
                    taken[kind].add(short)
        return found

    def _odd(self, bases: set[str]) -> bool:
        """Whether a class has a base that is not here."""
        return any(base not in self._bases for base in bases)

    def _family(self, kind: str) -> str:
        """A name for all classes that are kin to this one: the first of them."""
        kin = {kind}
        while True:
            more = {k for k, bases in self._bases.items() if k in kin or bases & kin}
            more |= {base for k in kin for base in self._bases.get(k, ())}
            if more <= kin:
                return min(kin)
            kin |= more


def _is_plain(name: str) -> bool:
    return len(name) > _LETTERS and not name.startswith("__")


@cache
def _outside() -> frozenset[str]:
    """Names of what MicroPython's objects have: as Python's do, and those of the hardware."""
    kinds = [kind for kind in vars(builtins).values() if isinstance(kind, type)]
    kinds += [array.array, io.StringIO, io.FileIO, type(_outside), types.GeneratorType]
    names = {name for kind in kinds for name in dir(kind)}
    for file in paths.SHIM.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute):
                names.add(node.attr)
            elif isinstance(node, ast.FunctionDef):
                names.add(node.name)
    return frozenset(name for name in names if name[0] != "_" or name[:2] == "__")


# What becomes of it


def _attribute_edits(tree: ast.Module, short: Mapping[str, str]) -> Iterator[_Edit]:
    for text, name in scan.rows(tree):
        if name in short:
            yield _Edit(text.lineno, text.col_offset + 1, name, short[name])
    for node in ast.walk(tree):
        match node:
            case ast.Attribute(_, name) if name in short:
                column = (node.end_col_offset or 0) - len(name.encode())
                yield _Edit(node.end_lineno or 0, column, name, short[name])
            case ast.ClassDef():
                for method in scan.private_methods(node):
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
        for node in ast.walk(tree):
            if isinstance(node, ast.Name) and node.id in short:
                yield _edit(node, node.id, short[node.id])


def _shared_edits(tree: ast.Module, short: Mapping[str, str]) -> Iterator[_Edit]:
    yield from _uses([tree], short)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                if alias.name in short:
                    yield _Edit(alias.lineno, alias.col_offset, alias.name, short[alias.name])


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
