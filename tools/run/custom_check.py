"""Check the user's own Python before it is on a board: its requirements and its faults.

Static checks come first: names of pins, imports, syntax that MicroPython's compiler refuses. Then
the code is imported as a board would, and each handler's word and parameters are checked. Faults
that show only when a handler runs are found by custom_try.py.

own: the user's Python. verdict: the results, to which the checks add. around: see machine.Around.
A note is a registered handler: kind (M or G for a word, else an event), key (the word's number,
…), letters of the word's parameters (lower case: optional), sync (when it runs, as in _WHEN), and
the function.
"""

import ast
import inspect
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..boardfile.board_check import is_simulated
from ..boardfile.files import load_board
from ..compiling import compilers
from ..compiling.compilers import CompilerError
from . import machine, watch
from .board_modules import ON_BOARDS, ON_ONE_CHIP
from .machine import Around
from .own_python import LackError, Module, OwnPython, OwnPythonError
from .program import ProgramLink

API = "ugrbl"
# Values that an event passes to its handlers, after m.
_VALUES: dict[str, tuple[object, ...]] = {
    "state_change": ("Idle", "Run"),
    "alarm": (5,),
    "tool_select": (1,),
    "tool_change": (1,),
    "probe_done": (None,),
    "spindle": ("M3", 1000.0),
    "coolant": (True, False),
    "input": (True,),
}
# When a word's handler runs, by its `sync`; True is the usual: after motion.
_WHEN = {True: "", False: ", during motion", None: ", before motion"}
_LETTERS = "ABCDEFHIJKLOPQRSTUVWXYZ"  # G and M are separate words, N is the line number


@dataclass
class Verdict:
    """The result of a check. handlers: all handlers, by title. tried: each one with its result.
    notes: what could not be checked. untried: why no handler could be tried here."""

    handlers: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    untried: list[str] = field(default_factory=list)
    # title, result in words, success
    tried: list[tuple[str, str, bool]] = field(default_factory=list)

    @property
    def is_good(self) -> bool:
        """Return whether nothing is wrong and the handlers could be tried."""
        return not self.problems and not self.untried and all(good for _, _, good in self.tried)

    def as_json(self) -> dict[str, Any]:
        """Return the result for other programs."""
        tried = [{"handler": name, "said": words, "ok": good} for name, words, good in self.tried]
        return {**vars(self), "tried": tried, "ok": self.is_good}


def check_statically(own: OwnPython, board: Any, verdict: Verdict) -> None:
    """Check everything that needs no execution."""
    for module in own.modules.values():
        verdict.problems += _syntax(module, verdict)
        verdict.problems += _imports(own, module, board)
        verdict.problems += _prints(module)
    options = {**vars(board), **machine.assumed_pins(board, own)}
    verdict.problems += unknown_pins(own, options.get("OUTPUTS", {}), options.get("INPUTS", {}))


def unknown_pins(own: OwnPython, outputs: Collection[str], inputs: Collection[str]) -> list[str]:
    """Return a message for each name of a pin that the board file does not define."""
    messages = []
    for used, option, names in (
        (own.outputs(), "OUTPUTS", outputs),
        (own.inputs(), "INPUTS", inputs),
    ):
        known = f"there are {', '.join(names)}" if names else f"{option} names none"
        for module, line, name in used:
            if name not in names:
                pin = f"{option[:-1].lower()} {name}"  # "output air"
                messages.append(
                    f"{module.file}, line {line}: the board file names no {pin}; {known}"
                )
    return messages


def _syntax(module: Module, verdict: Verdict) -> Iterator[str]:
    """Yield syntax that CPython accepts and MicroPython refuses."""
    try:
        traceback = compilers.refusal(module.source)
    except CompilerError as error:
        verdict.notes = [f"not checked by MicroPython's compiler: {error}"]
        return
    if traceback:
        line_numbers = re.findall(r", line (\d+)", traceback)
        line = int(line_numbers[-1]) if line_numbers else 0  # 0: unknown
        reason = traceback.splitlines()[-1]
        yield f"{module.file}, line {line}: MicroPython says: {reason}{_why(module, line)}"


def _why(module: Module, line: int) -> str:
    """Return the unsupported construct, if it is easy to recognise; else ""."""
    for node in ast.walk(module.tree):
        if isinstance(node, ast.stmt) and node.lineno == line and type(node).__name__ == "Match":
            return ": MicroPython has no match statement"
        if isinstance(node, ast.FunctionDef) and node.args.posonlyargs and node.lineno == line:
            return ": MicroPython has no / among parameters"
    return ""


def _imports(own: OwnPython, module: Module, board: Any) -> Iterator[str]:
    """Yield imports of modules that a board does not have."""
    engine = getattr(board, "ENGINE", "")
    on_chip = ON_ONE_CHIP["esp" if engine in ("rmt", "i2s") else "pio"]
    if is_simulated(board):  # those of every chip
        on_chip = frozenset().union(*ON_ONE_CHIP.values())
    for line, name in _imported(module.tree):
        first = name.partition(".")[0]
        if not first and not own.is_folder:  # a relative import has no name
            yield f"{module.file}, line {line}: relative imports need a folder; this is one file"
        elif first and first not in ON_BOARDS | on_chip | {API, own.name}:
            yield f"{module.file}, line {line}: no board has a module {name}"


def _prints(module: Module) -> Iterator[str]:
    """Yield calls of print(), because their output would mix with the answers to the sender."""
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            to_file = any(keyword.arg == "file" for keyword in node.keywords)
            if node.func.id == "print" and not to_file:
                yield (
                    f"{module.file}, line {node.lineno}: print() would mix with answers to the "
                    "sender: use m.message(text)"
                )


def _imported(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and name of each import; the name is "" for a relative import."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.lineno, "" if node.level else node.module or ""


# Registered handlers


def import_and_examine(
    own: OwnPython, board: str, around: Around, verdict: Verdict
) -> "Sequence[Any]":
    """Import the user's Python in the simulator. Returns its handlers, or () if something is
    wrong."""
    # A sender that sends nothing: the machine starts, imports the Python, and is switched off.
    rig = machine.build(board, lambda rig: ProgramLink(rig, lambda _link: iter(())), around=around)
    rig.custom_module.examine = lambda cnc, notes: _examine(own, cnc, notes, verdict)
    try:
        if watch.is_late(lambda: machine.run(rig)):
            verdict.problems.append(
                f"{own.path}: importing it took longer than {watch.LONGEST_S:g} s: code outside "
                "of handlers runs once, at start, and must end"
            )
            return ()
    except LackError as error:
        verdict.untried.append(str(error))
        return ()
    except OwnPythonError as error:
        if not verdict.problems:
            verdict.problems.append(str(error))
        return ()
    if not rig.custom_module.notes:
        verdict.problems.append(
            f"{own.path} has no handler: mark a function with @mcode, @gcode, @on… or @every"
        )
    return tuple(rig.custom_module.notes)


def called(note: Any) -> str:
    """Return the firmware's name of a handler: `M100`, `on.tool_change`, `every 50`."""
    from extras.custom.user_modules import title

    return str(title(note[0], note[1]))


def title(note: Any) -> str:
    """Return the name with parameters: `M100 P [Q]`, `on.tool_change`, `every 50 ms`."""
    kind, _, letters, sync, _ = note
    if kind in "MG":
        # Optional letters are in brackets.
        words = [letter if letter.isupper() else f"[{letter.upper()}]" for letter in letters]
        return " ".join([called(note), *words]) + _WHEN[sync]
    return called(note) + (" ms" if kind == "every" else "")


def _examine(own: OwnPython, cnc: Any, notes: "list[Any]", verdict: Verdict) -> None:
    """Add each registered handler and its problems to the verdict. cnc: the firmware's machine.
    OwnPythonError if there is a problem."""
    first_place: dict[tuple[str, Any], str] = {}  # of each word
    for note in notes:
        kind, key, letters, _, function = note
        verdict.handlers.append(title(note))
        where = _place(function)
        problems = [*_word(cnc, kind, key, letters)] if kind in "MG" else []
        if kind in "MG" and (kind, key) in first_place:
            problems.append(f"{kind}{key} is defined twice: {first_place[kind, key]}")
        first_place.setdefault((kind, key), where)
        problems += _parameters(kind, letters, function)
        verdict.problems += [f"{where}: {problem}" for problem in problems]
    if verdict.problems:
        raise OwnPythonError(verdict.problems[0])


def _place(function: "Callable[..., Any]") -> str:
    """Return file and line of a function."""
    code = getattr(inspect.unwrap(function), "__code__", None)
    return f"{code.co_filename}, line {code.co_firstlineno}" if code else repr(function)


def _word(cnc: Any, letter: str, number: Any, letters: Any) -> Iterator[str]:
    """Yield what is wrong with a word: its number, or its parameters' letters.

    letter, number: `M`, 100, as registered, so the number may be anything; G may have `10 L1`.
    letters: its parameters, `Pq`.
    """
    word = f"{letter}{number}"
    if letter == "G" and re.fullmatch(r"\d+(\.\d)? L\d+", str(number)):
        number, is_number = float(str(number).split(" ")[0]), True
    else:
        is_number = isinstance(number, int | float) and not isinstance(number, bool)
    if not is_number or number < 0 or (letter == "M" and number != int(number)):
        right = "a whole number" if letter == "M" else 'a number such as 81 or 81.1, or "10 L1",'
        yield f"{word}: {right} must follow {letter}"
    elif abs(number * 10 - round(number * 10)) > 1e-6:
        yield f"{word}: the number may have one decimal place at most"
    elif cnc.is_taken(letter, word[1:]):
        yield f"{word} is already used by Grbl or by another extra: choose another"
    if not isinstance(letters, str):
        yield f'{word}: its letters must be a text: "Pq"'
        return
    for each in letters:
        if each.upper() not in _LETTERS:
            yield f"{word}: {each!r} cannot be a parameter: use letters other than G, M and N"
    for repeated in {each for each in letters.upper() if letters.upper().count(each) > 1}:
        yield f"{word}: {repeated} is listed twice in {letters!r}"


def _parameters(kind: str, letters: Any, function: "Callable[..., Any]") -> Iterator[str]:
    """Compare the function's parameters with the values it will be called with."""
    if inspect.isgeneratorfunction(function):
        yield f"{function.__name__} has a yield, so none of it would run: remove it"
        return
    if inspect.iscoroutinefunction(function):
        yield f"{function.__name__} is async, so none of it would run: remove async"
        return
    parameters = inspect.signature(function).parameters
    if not parameters:
        yield f"{function.__name__}() has no parameter m: the machine must be its first parameter"
        return
    if kind in "MG":
        yield from _letters(str(letters), parameters, function.__name__)
        return
    values = _VALUES.get(kind, ())
    try:
        inspect.signature(function).bind(None, *values)
    except TypeError as error:
        count = len(values)
        given = "m alone" if not count else f"m and {count} value{'s' * (count > 1)}"
        yield f"{function.__name__}() gets {given}: {error}"


def _letters(letters: str, parameters: Any, name: str) -> Iterator[str]:
    """Yield the faults of a word's handler: it must accept each letter of the word as a parameter.

    letters: those of the word, upper case if required, lower case if the line may leave it out.
    parameters: the handler's, the first of which is m. A fault is a letter without a parameter, an
    optional letter whose parameter has no default, or a parameter without a default that no letter
    fills. **kwargs accepts every letter.
    """
    _, *others = parameters.values()
    takes_all = any(each.kind is each.VAR_KEYWORD for each in others)
    unfilled = {each.name: each for each in others if each.kind is not each.VAR_KEYWORD}
    for letter in letters:
        upper = letter.upper()
        parameter = unfilled.pop(upper, None)
        if parameter is None:
            if not takes_all:
                is_lower = letter.lower() in unfilled
                hint = f": it is called {upper}, not {letter.lower()}" if is_lower else ""
                yield f"{name}() has no parameter {upper}{hint}"
        elif letter.islower() and parameter.default is parameter.empty:
            yield f"{name}(): {upper} may be missing on the line, so it needs a default: {upper}=0"
    for parameter in unfilled.values():
        if parameter.default is parameter.empty and parameter.kind is not parameter.VAR_POSITIONAL:
            yield f"{name}(): no letter sets {parameter.name}; its letters are {letters!r}"


def check(own: OwnPython, board: str, around: Around) -> "tuple[Verdict, Sequence[Any]]":
    """Run all checks that run no handler. Returns the result and the handlers that can be
    tried."""
    verdict = Verdict()
    check_statically(own, load_board(board), verdict)
    notes = () if verdict.problems else import_and_examine(own, board, around, verdict)
    return verdict, notes
