"""The modules of a package become one, before the firmware is compiled for a board.

MicroPython keeps for each module an object, its dictionary with every name that it imports, a
table of the names in its code, and its own name and its file's as texts: some 300 bytes. So what
a board needs of a package is written into one module, in the order of its imports: the package
itself, `motion/__init__.mpy`. What its parts want from each other is there without an import.

What is forgotten after start, which the sources say (_FORGET), is one module, too, for every file
takes MicroPython milliseconds to find, and every name one more search: that which the others are
forgotten in, and it goes as a whole. Those of ON_REQUEST and what main.py imports stay apart.
Where two parts mean different things by a name, one has its module's name behind it. What is not
understood here is refused.
"""

import ast
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from typing import NamedTuple

from . import scan
from .scan import FORGET, ON_REQUEST
from .scopes import CONST, Meaning, Module, NotUnderstood, Ours, Rewriter
from .short_names import SHORT


class Bundles(NamedTuple):
    """Texts by the name of the module. origins: of those that were several before, by the
    global name: which module it is from, and its name there."""

    texts: dict[str, str]
    origins: dict[str, dict[str, Meaning]]


def bundle(sources: Mapping[str, str]) -> Bundles:
    """One module for each package, and those that stay apart. Raises NotUnderstood."""
    homes = {name: name for name in _apart(sources)} | _of_start(sources)
    modules = {
        name: Module(name, text, homes.get(name, name.partition(".")[0]))
        for name, text in sources.items()
    }
    ours = Ours(modules)
    units = {name: _Unit(name, parts, ours) for name, parts in _parts(ours).items()}
    for unit in units.values():
        unit.name_own()
    for unit in units.values():
        unit.name_imported(units)
    _ordered({name: unit.imported() for name, unit in units.items()}, "packages")
    return Bundles(
        {name: unit.text(units) for name, unit in units.items()},
        {name: unit.origins() for name, unit in units.items() if unit.parts != [name]},
    )


def _apart(sources: Mapping[str, str]) -> Iterator[str]:
    """Modules that are not merged."""
    for name, text in sources.items():
        if name.partition(".")[0] in ON_REQUEST:
            yield name
        if "." not in name:  # main.py, which stays as it is
            yield name
            for statement in ast.parse(text).body:
                if isinstance(statement, ast.ImportFrom):
                    yield from (f"{statement.module}.{alias.name}" for alias in statement.names)


def _of_start(sources: Mapping[str, str]) -> dict[str, str]:
    """Of modules that are forgotten: the one that they are part of, the last to be forgotten."""
    by: dict[str, str] = {}
    for name, text in sources.items():
        by |= {module: name for module in _forgotten(text) if module in sources}

    def last(module: str) -> str:
        return last(by[module]) if by[module] in by else module

    return {module: last(module) for module in by}


@lru_cache(1024)
def _forgotten(text: str) -> tuple[str, ...]:
    return tuple(scan.named_in_calls(ast.parse(text), FORGET))


def _parts(ours: Ours) -> dict[str, list[Module]]:
    """The modules that each unit is made of, in the order of their imports."""
    needs = {
        name: [needed.module for needed in _needed(ours, module)]
        for name, module in ours.modules.items()
    }
    found: dict[str, list[Module]] = {}
    for name in _ordered(needs, "modules"):
        found.setdefault(ours.modules[name].unit, []).append(ours.modules[name])
    return found


def _needed(ours: Ours, module: Module) -> Iterator[Meaning]:
    """What it imports of our modules."""
    for said in module.imports.values():
        meaning = ours.source(said)
        if meaning.module in ours.modules:
            yield meaning


def _ordered(needs: Mapping[str, Iterable[str]], what: str) -> list[str]:
    """Those first that others need."""
    done: dict[str, bool] = {}

    def add(name: str, way: tuple[str, ...]) -> None:
        if name in way:
            raise NotUnderstood(f"{what} import each other: {' <- '.join((*way, name))}")
        if name not in done:
            for needed in sorted(needs[name]):
                add(needed, (*way, name))
            done[name] = True

    for name in sorted(needs):
        add(name, ())
    return list(done)


class _Unit:
    """A module that is written, and of what."""

    def __init__(self, name: str, parts: list[Module], ours: Ours) -> None:
        self.name = name
        self.parts = [part.name for part in parts]
        self.names: dict[Meaning, str] = {}
        self._parts = parts
        self._ours = ours
        self._uses: dict[Meaning, list[tuple[Module, str]]] = {}  # by whom, under which name
        self._constants = {Meaning(p.name, c) for p in parts for c in p.constants}
        for part in parts:
            self._read(part)

    def _read(self, part: Module) -> None:
        def note(meaning: Meaning, name: str) -> str:
            self._uses.setdefault(meaning, []).append((part, name))
            return name

        Rewriter(self._ours, part, note, lambda meaning: meaning.name).visit(part.tree())
        for name, said in part.imports.items():
            if said.module not in self._ours.modules and self._ours.source(said) == said:
                note(said, name)

    # Names

    def name_own(self) -> None:
        """Names of Python's stay; then what the parts make has its own name if it can."""
        for meaning in self._uses:
            if not meaning.module:
                self.names[meaning] = meaning.name
        for part in self._parts:
            for name in part.own:
                self._choose(Meaning(part.name, name), [name])

    def name_imported(self, units: "Mapping[str, _Unit]") -> None:
        """What others make is called as they do, if it can."""
        for meaning, uses in self._uses.items():
            if meaning not in self.names:
                home = self._home(meaning)
                there = [units[home].names[meaning]] if home else []
                here = (name for _, name in uses if name)
                self._choose(meaning, [*there, *here, meaning.name])

    def _home(self, meaning: Meaning) -> str:
        """The unit of ours where it is made."""
        module = self._ours.modules.get(meaning.module)
        return module.unit if module else ""

    def _choose(self, meaning: Meaning, wanted: list[str]) -> None:
        short = SHORT if wanted[0] in SHORT else []
        found = (name for name in (*wanted, *short) if self._is_free(name, meaning))
        name = next(found, "")
        last = meaning.module.rpartition(".")[2]
        longer = f"{wanted[0]}_{last}"
        while not name:
            name = longer if self._is_free(longer, meaning) else ""
            longer += "_"
        self.names[meaning] = name

    def _is_free(self, name: str, meaning: Meaning) -> bool:
        uses = self._uses.get(meaning, [])
        if name in self.names.values():
            return False
        if any(name in part.inner for part, known in uses if known != name):
            return False
        if meaning in self._constants:  # the compiler does not know of scopes
            return not any(name in p.words for p in self._parts if p.name != meaning.module)
        return True

    def origins(self) -> dict[str, Meaning]:
        """What is made here: where it was made."""
        return {
            self.names[Meaning(part.name, name)]: Meaning(part.name, name)
            for part in self._parts
            for name in part.own
        }

    # What is written

    def imported(self) -> set[str]:
        """The units that it wants before it is run."""
        return {home for meaning in self._uses if (home := self._home(meaning))} - {self.name}

    def text(self, units: "Mapping[str, _Unit]") -> str:
        """The source."""

        def find(meaning: Meaning, name: str) -> str:
            return self.names[meaning]

        def there(meaning: Meaning) -> str:
            return units[self._home(meaning)].names[meaning]

        body = list(self._imports(units))
        for part in self._parts:
            body += Rewriter(self._ours, part, find, there).visit(part.tree()).body
        return ast.unparse(ast.fix_missing_locations(ast.Module(body, []))) + "\n"

    def _imports(self, units: "Mapping[str, _Unit]") -> Iterator[ast.stmt]:
        asked: dict[str, list[ast.alias]] = {}
        if any(CONST in part.imports.values() for part in self._parts):
            asked[CONST.module] = [ast.alias(CONST.name)]
        for meaning, name in self.names.items():
            home = self._home(meaning)
            if meaning.module and not meaning.name:
                yield ast.Import([_alias(meaning.module, name)])
            elif meaning.module and home != self.name:
                there = units[home].names[meaning] if home else meaning.name
                asked.setdefault(home or meaning.module, []).append(_alias(there, name))
        for module, names in asked.items():
            yield ast.ImportFrom(module, names, 0)


def _alias(name: str, here: str) -> ast.alias:
    return ast.alias(name, None if name == here else here)
