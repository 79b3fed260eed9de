"""What a board tells of a fault, in the sources' own names and lines.

Told in a traceback at the prompt, or in one line, `[MSG:…]`, in which "ok" and "error" are spoken
otherwise, for senders would take them for answers (boot/power_up.py). Native functions are in no
traceback: a fault in one is told of who called it.
"""

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

_MESSAGE = re.compile(r"\[MSG:(?:Last fault: )?([^\]]*)\]")
_BUILD = re.compile(r"\(([0-9a-f]{8}|-{8})\)|\bBuild: ([0-9a-f]{8}|-{8})")
_PLACE = re.compile(r'File "([\w./]+)", line (\d+)(?:, in (<?\w+>?))?')
_ATTRIBUTE = re.compile(r"'(\w+)'( object has no attribute )'(\w+)'")
_NAME = re.compile(r"(name )'(\w+)'( isn't defined)|(can't import name )(\w+)")
_OK = re.compile("[oO]-[kK]")
_ERR = re.compile("Err(?!or)")


class Place(NamedTuple):
    """A function in its file. lines: all of its, or the one, where the board knows it."""

    file: str
    function: str
    lines: tuple[int, int]

    def __str__(self) -> str:
        first, last = self.lines
        where = f"line {first}" if first == last else f"lines {first} to {last}"
        return f"{self.file}, {where}: {self.function}"


def build_of(text: str) -> str:
    """The id of the build that told this; an empty text where it does not say."""
    found = _BUILD.findall(text)
    return "".join(found[-1]) if found else ""


def is_fault(text: str) -> bool:
    """Whether it tells where something has failed."""
    return _PLACE.search(text) is not None


def decode(text: str, map_: dict[str, Any]) -> Iterator[str]:
    """The same lines in the sources' names, each place followed by where it is."""
    module = ""  # where it has failed: a traceback tells that before it tells why
    for line in text.splitlines():
        said = _plain(line)
        places = list(_PLACE.finditer(said))
        module = _module(places[-1]) if places else module
        yield _renamed(said, _of_module(module, map_), map_)
        for place in places:
            yield from (f"    {found}" for found in _places(place, map_))


def _plain(line: str) -> str:
    """A message as the exception has said it."""
    found = _MESSAGE.search(line)
    if not found:
        return line
    text = _OK.sub(lambda match: match[0].replace("-", ""), found[1])
    return _ERR.sub("Error", text)


def _renamed(line: str, module: dict[str, Any], map_: dict[str, Any]) -> str:
    """With long names for short ones, where the text says that it is a name."""

    def attribute(match: "re.Match[str]") -> str:
        kind, words, name = match.groups()
        of_class = map_["classes"].get(kind, {}).get(name)
        names = [of_class] if of_class else _meant("attributes", name, module, map_)
        return f"'{kind}'{words}{_quoted(names, name)}"

    def variable(match: "re.Match[str]") -> str:
        name = match[2] or match[5]
        names = _meant("variables", name, module, map_)
        return f"{match[1] or match[4]}{_quoted(names, name)}{match[3] or ''}"

    return _NAME.sub(variable, _ATTRIBUTE.sub(attribute, line))


def _quoted(names: list[str], told: str) -> str:
    return " or ".join(f"'{name}'" for name in names) if names else f"'{told}'"


def _meant(kind: str, short: str, module: dict[str, Any], map_: dict[str, Any]) -> list[str]:
    """What a name may be in this module, else in any. kind: as symbols.py has them."""
    names: list[str] = module.get(kind, {}).get(short, [])
    every = (module[kind].get(short, ()) for module in map_["modules"].values())
    return names or sorted({name for names in every for name in names})


def _places(told: "re.Match[str]", map_: dict[str, Any]) -> Iterator[Place]:
    """Which functions it may be: a short name may be of several classes, or be cut off."""
    module = _of_module(_module(told), map_)
    bundle = map_.get("bundles", {}).get(_module(told), {})
    if module and not bundle:
        yield from _in_module(told, told[3] or "", module)
    else:
        yield from _in_bundle(told, bundle, map_)


def _module(told: "re.Match[str]") -> str:
    """The module of a place: what is frozen tells its file, `motion/__init__.py`."""
    if "/" not in told[1]:
        return told[1]
    return told[1].removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def _in_bundle(
    told: "re.Match[str]", bundle: dict[str, Any], map_: dict[str, Any]
) -> Iterator[Place]:
    """The same where several modules are one on the board (bundle.py)."""
    package, function = _module(told), told[3] or ""
    if function in bundle:
        module, function = bundle[function]
        yield from _in_module(told, function, map_["modules"][module])
        return
    parts = {module for module, _ in bundle.values()}
    for name, module in map_["modules"].items():
        if name in parts or (not parts and name.startswith(package + ".")):
            if _functions(function, module, [*module["functions"]]):
                yield from _in_module(told, function, module)


def _in_module(told: "re.Match[str]", function: str, module: dict[str, Any]) -> Iterator[Place]:
    line = module.get("lines", {}).get(told[2], 0)
    spans = {name: (first, last) for name, (first, last) in module["functions"].items()}
    found = _functions(function, module, [*spans])
    if line:
        found = [name for name in found if spans[name][0] <= line <= spans[name][1]] or found
    for name in found:
        yield Place(module["file"], name, (line, line) if line else spans[name])
    if not found and (line or told[3] in (None, "<module>")):
        yield Place(module["file"], told[3] or "somewhere", (line or 1, line or module["length"]))


def _functions(told: str, module: dict[str, Any], there: list[str]) -> list[str]:
    """Those that a board may mean by this. An "error" in a name may have got a capital."""
    meant = {name.lower() for name in (told, *module["attributes"].get(told, ())) if name}
    found = [name for name in there if _last(name).lower() in meant]
    return found or [name for name in there if told and _last(name).startswith(told)]


def _of_module(name: str, map_: dict[str, Any]) -> dict[str, Any]:
    modules = {known.lower(): module for known, module in map_["modules"].items()}
    found: dict[str, Any] = modules.get(name.lower(), {})
    return found


def _last(name: str) -> str:
    return name.rpartition(".")[2]
