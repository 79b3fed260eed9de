"""The board's `micropython` module for CPython, with viper arithmetic that cannot wrap unnoticed.

Checked (the default): everything that would wrap or fail silently on the board raises: results
outside signed 32 bits, division by zero, shift counts outside 0..31, floats, negative indices.
Literals of 2**30 and more are heap objects there: refused, unless written int(literal).

Fast (UGRBL_VIPER=fast, or VIPER = "fast" here before the firmware is imported): casts only, or a
function that `compiled` provides (run/kernels.py), which raises in the same places.

Pointers are memoryviews: ptr32 has signed words, ptr16 and ptr8 unsigned ones. An index past the
end, or a value that does not fit, raises in both modes. What is not modelled does not exist.
"""

import ast
import builtins
import copy
import gc
import hashlib
import io
import linecache
import marshal
import os
import sys
import traceback
from array import array
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, NoReturn, TypeVar, cast

_Value = TypeVar("_Value")
_Result = TypeVar("_Result")
_Node = TypeVar("_Node", bound=ast.AST)

VIPER = os.environ.get("UGRBL_VIPER", "checked")
# In fast mode, returns a function compiled to C, by module and name; or None.
compiled: "Callable[[str, str], Any] | None" = None

_OURS = Path(__file__).read_text("utf-8")
_ROOT = Path(__file__).resolve().parents[3]
_WORD_LIMIT = 1 << 31
_SMALL_INT_LIMIT = 1 << 30
_WORD_BITS = 32
_VIEWS_KEPT = 1000
# Addresses that `machine` has.
_REGISTERS = range(0x40000000, 0x50000000)  # of the chip's slow peripherals
_LEVELS = 0xD0000004 - (1 << _WORD_BITS)  # the register of the pins' levels, as a signed word


def const(value: _Value, /) -> _Value:
    return value


native = const


def alloc_emergency_exception_buf(size: int, /) -> None:
    """Do nothing: CPython needs no buffer."""


def stack_use() -> int:
    """Return 0: a desktop's stack is large enough."""
    return 0


def _print_exception(fault: BaseException, file: Any = None) -> None:
    """Add MicroPython's sys.print_exception(); there a file of bytes accepts text."""
    text = "".join(traceback.format_exception(fault))
    if isinstance(file, io.BytesIO):
        file.write(text.encode("utf-8", "surrogatepass"))
    else:
        (file or sys.stdout).write(text)


sys.print_exception = _print_exception
gc.threshold = const  # type: ignore[assignment]  # CPython collects by its own rule


def kbd_intr(char: int, /) -> None:
    """Do nothing: Ctrl-C on the desktop is for the desktop."""


# No parameter types, because an array is valid for a pointer. The call itself checks them.
def viper(function: Callable[..., _Result], /) -> Callable[..., _Result]:
    """Compile again with pointer casts at entry and, unless VIPER is "fast", all checks."""
    plain = cast(FunctionType, function)
    if VIPER == "fast" and compiled and (in_c := compiled(plain.__module__, plain.__qualname__)):
        return cast("Callable[..., _Result]", in_c)
    return cast("Callable[..., _Result]", _run_factory(plain, _factory_code(plain)))


def _factory_code(plain: FunctionType) -> CodeType:
    """Return the code of a factory that makes the function, see _compile(). A checkout caches it,
    as compiling/cache.py does, because compiling takes most of a process's start time."""
    file = _cache_file(plain)
    try:
        return cast(CodeType, marshal.loads(file.read_bytes()))
    except (OSError, EOFError, ValueError, TypeError):  # not there, or damaged
        code = _compiled(plain)
    if (_ROOT / "firmware").is_dir():  # a checkout
        with suppress(OSError):  # the folder is not writable
            file.parent.mkdir(parents=True, exist_ok=True)
            new = file.with_suffix(f".{os.getpid()}")  # others may write the same file
            new.write_bytes(marshal.dumps(code))
            new.replace(file)
    return code


def _cache_file(plain: FunctionType) -> Path:
    """Return the file of the function's code; its name depends on all that the code depends on."""
    code, names = plain.__code__, plain.__globals__
    constants = {n: names[n] for n in code.co_names if isinstance(names.get(n), (int, float))}
    source = "".join(linecache.getlines(code.co_filename, names))
    key = repr((sys.version, _OURS, VIPER, code.co_filename, code.co_firstlineno, constants))
    return _ROOT / "build" / "cache" / hashlib.sha256((key + source).encode()).hexdigest()


def _compiled(plain: FunctionType) -> CodeType:
    """Return the code for _factory_code(), not from the cache."""
    node = _definition(plain)
    _check_signature(plain, node)
    is_checked = VIPER != "fast"
    if is_checked:
        _Checks(plain).generic_visit(node)
    at_entry = {**_POINTER_CASTS, **(_INT_CHECKS if is_checked else {})}  # by the argument's type
    node.body[:0] = [
        _statement(at_entry[_type(argument)].format(argument.arg), argument)
        for argument in node.args.args
        if _type(argument) in at_entry
    ]
    return _compile(plain, node)


# Views by their own id. As an argument, such a view stands for the array that it shows.
kept_views: dict[int, memoryview] = {}


class _Pointer:
    """ptr8, ptr16 or ptr32. Views of arrays are kept: making one costs more than a kernel."""

    def __init__(self, element: str) -> None:
        self._element = element  # its letter in memoryview.cast()
        self.views: dict[int, memoryview] = {}  # by id; a view keeps its object alive

    def __call__(self, memory: Any, /) -> Any:
        """Return a view of an array, of another view, or of registers at an address."""
        if isinstance(memory, int) and (memory in _REGISTERS or memory == _LEVELS):
            return _Registers(memory)
        view = self.views.get(id(memory))
        if view is None:
            view = memoryview(memory).cast("B").cast(cast(Any, self._element))
            is_kept_view = kept_views.get(id(memory)) is memory
            if is_kept_view or isinstance(memory, (array, bytearray)):
                if len(kept_views) >= _VIEWS_KEPT:
                    # All at once, because a view may be known by the id of another.
                    kept_views.clear()
                    for pointer in _POINTERS.values():
                        pointer.views.clear()
                if is_kept_view:
                    kept_views[id(memory)] = memory  # again, if it was just forgotten
                # Also for the view, because a viper function may pass its pointer on.
                self.views[id(memory)] = self.views[id(view)] = kept_views[id(view)] = view
        return view


class _Registers:
    """A pointer made from an address: to the registers of the stand-in for `machine`."""

    def __init__(self, address: int) -> None:
        import machine

        self._memory, self._address = machine.mem32, address

    def __getitem__(self, index: int) -> int:
        value = int(self._memory[self._address + 4 * index])
        return value - (value >> 31 << 32)  # signed

    def __setitem__(self, index: int, value: int) -> None:
        self._memory[self._address + 4 * index] = _int(value)


def _int(value: Any, low: int = -_WORD_LIMIT, limit: int = _WORD_LIMIT) -> int:
    if not isinstance(value, int):
        raise TypeError(f"viper computes with integers, not with {value!r}")
    if not low <= value < limit:
        raise OverflowError(f"{value} leaves 32 bits")
    return value


def _uint(value: Any) -> int:
    return _int(value, limit=2 * _WORD_LIMIT) & 0xFFFFFFFF


def _shift_count(value: int) -> int:
    if not 0 <= value < _WORD_BITS:
        raise OverflowError(f"shift by {value}: the result depends on the chip")
    return value


def _index(value: _Value) -> _Value:
    if isinstance(value, int) and value < 0:
        raise IndexError(f"index {value} is before the start of the buffer")
    return value


class _Checks(ast.NodeTransformer):
    """Adds checks to results; refuses what the board cannot do, or does only with objects."""

    _CHECKED = (ast.Add, ast.Sub, ast.Mult, ast.LShift, ast.FloorDiv, ast.Mod)
    _REFUSED = (
        *(ast.FunctionDef, ast.Lambda, ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp),
        *(ast.Tuple, ast.List, ast.Dict, ast.Set, ast.JoinedStr, ast.Slice),
        *(ast.Yield, ast.YieldFrom, ast.Div, ast.Pow),
    )

    def __init__(self, function: FunctionType) -> None:
        self._function = function

    def visit(self, node: ast.AST) -> Any:
        is_unpacking = isinstance(node, ast.Tuple) and isinstance(node.ctx, ast.Store)
        if isinstance(node, self._REFUSED) and not is_unpacking:
            _refuse(self._function, f"{type(node).__name__} is not for viper", node)
        return super().visit(node)

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        return self._literal(node, node.value)

    def visit_Name(self, node: ast.Name) -> ast.AST:
        if node.id in self._function.__code__.co_varnames:
            return node
        return self._literal(node, self._function.__globals__.get(node.id))

    def _literal(self, node: ast.AST, value: object) -> ast.AST:
        """Return the node, unless the value of this literal or constant is refused."""
        if isinstance(value, float):
            _refuse(self._function, f"{value} is a float", node)
        if isinstance(value, int) and not -_SMALL_INT_LIMIT <= value < _SMALL_INT_LIMIT:
            _refuse(self._function, f"{value} is a heap object: write int({value:#x})", node)
        return node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        """Replace casts to pointers, and int(), whose argument may be a large literal."""
        name = node.func.id if isinstance(node.func, ast.Name) and node.args else ""
        if name in _POINTERS and isinstance(node.args[0], ast.Name):
            source = _KNOWN_VIEW.format(name, node.args[0].id)
            return _placed(ast.parse(source, mode="eval").body, node)
        if name != "int":
            return self.generic_visit(node)
        inner = node.args[0]
        of_literal = (ast.Constant, ast.Name, ast.UnaryOp, ast.unaryop, ast.expr_context)
        is_literal = all(isinstance(part, of_literal) for part in ast.walk(inner))
        return _call("viper_int", inner if is_literal else self.visit(inner))

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        self.generic_visit(node)
        if self._constant(node.slice) < 0:  # known only at run time
            node.slice = _checked(_INDEX, node.slice)
        return node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        return _checked(_WORD, node) if isinstance(node.op, ast.USub) else node

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.op, (ast.LShift, ast.RShift)):
            if not 0 <= self._constant(node.right) < _WORD_BITS:  # not known to be valid
                node.right = _checked(_COUNT, node.right)
        return _checked(_WORD, node) if isinstance(node.op, self._CHECKED) else node

    def _constant(self, node: ast.expr) -> int:
        """Return the value of a number or of a name in capitals; -1 for everything else."""
        value = node.value if isinstance(node, ast.Constant) else None
        if isinstance(node, ast.Name) and node.id.isupper():
            value = self._function.__globals__.get(node.id)
        return value if isinstance(value, int) else -1

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        """Turn `p[i] += x` into `p[viper_at] = p[viper_at := i] + x`: the right side is first."""
        target = node.target
        old = cast(ast.expr, copy.deepcopy(target))
        cast(ast.Name, old).ctx = ast.Load()
        if isinstance(old, ast.Subscript) and isinstance(target, ast.Subscript):
            old.slice = ast.NamedExpr(ast.Name("viper_at", ast.Store()), old.slice)
            target.slice = ast.Name("viper_at", ast.Load())
        value = ast.copy_location(ast.BinOp(old, node.op, node.value), node)
        return self.generic_visit(ast.copy_location(ast.Assign([target], value), node))


def _check_signature(function: FunctionType, node: ast.FunctionDef) -> None:
    arguments = node.args
    if arguments.defaults or arguments.kwonlyargs or arguments.vararg or arguments.kwarg:
        _refuse(function, "viper takes plain positional arguments only", node)
    if function.__closure__:
        _refuse(function, "viper functions cannot use the locals of another function", node)
    places: list[ast.arg | ast.FunctionDef] = [*arguments.args, node]
    for typed in places:
        if _type(typed) not in (*_POINTER_CASTS, *_INT_CHECKS, "bool", "object"):
            why = f"{_type(typed)} is no viper type (a function without a result: return 0)"
            _refuse(function, why, typed)


def _type(node: "ast.arg | ast.FunctionDef") -> str:
    annotation = node.annotation if isinstance(node, ast.arg) else node.returns
    return "object" if annotation is None else ast.unparse(annotation)


def _refuse(function: FunctionType, why: str, node: ast.AST) -> NoReturn:
    code = function.__code__
    place = (code.co_filename, getattr(node, "lineno", code.co_firstlineno), None, None)
    raise SyntaxError(f"{function.__name__}: {why}", place)


@lru_cache(maxsize=8)
def _definitions(source: str) -> dict[tuple[str, int], ast.FunctionDef]:
    """Return functions by name and first line, that of a decorator included."""
    nodes = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)]
    return {(n.name, min([n.lineno, *(d.lineno for d in n.decorator_list)])): n for n in nodes}


def _definition(function: FunctionType) -> ast.FunctionDef:
    """Take the definition out of its file's tree, to change it. A second call parses it again."""
    code = function.__code__
    source = "".join(linecache.getlines(code.co_filename, function.__globals__))
    place = code.co_name, code.co_firstlineno
    if place not in _definitions(source):
        _definitions.cache_clear()
    if place not in (definitions := _definitions(source)):
        raise OSError(f"viper needs the source of {code.co_name} in {code.co_filename}")
    return definitions.pop(place)


def _statement(source: str, place: ast.AST) -> ast.stmt:
    return _placed(ast.parse(source).body[0], place)


def _placed(tree: _Node, place: ast.AST) -> _Node:
    for node in ast.walk(tree):
        ast.copy_location(node, place)
    return tree


# Conditions for a result, an index and a shift count. If one fails, the called function raises.
_WORD = "viper_now if (viper_now := value) >> 31 in (0, -1) else viper_int(viper_now)"
_INDEX = "viper_now if (viper_now := value) >= 0 else viper_index(viper_now)"
_COUNT = "viper_now if 0 <= (viper_now := value) < 32 else viper_count(viper_now)"


def _checked(check: str, value: ast.expr) -> ast.expr:
    """Return the value with an inline check: calls took half of the simulator's time."""
    tree = ast.parse(check, mode="eval").body
    nodes = [ast.copy_location(node, value) for node in ast.walk(tree)]
    (viper_now,) = (node for node in nodes if isinstance(node, ast.NamedExpr))
    viper_now.value = value  # in place of the name `value`
    return tree


def _call(name: str, argument: ast.expr) -> ast.expr:
    return ast.copy_location(ast.Call(ast.Name(name, ast.Load()), [argument], []), argument)


def _compile(function: FunctionType, node: ast.FunctionDef) -> CodeType:
    """Compile inside a factory: its parameters, the helpers, become closure cells, not globals."""
    node.decorator_list, node.returns = [], None
    for argument in node.args.args:
        argument.annotation = None
    factory = cast(ast.FunctionDef, ast.parse(f"def factory({', '.join(_HELPERS)}): pass").body[0])
    factory.body = [node, _statement(f"return {node.name}", node)]
    tree = ast.fix_missing_locations(ast.Module([factory], []))
    return compile(tree, function.__code__.co_filename, "exec", dont_inherit=True)


def _run_factory(function: FunctionType, code: CodeType) -> FunctionType:
    """Return the function that the code's factory makes, as the original one's replacement."""
    names: dict[str, Callable[..., FunctionType]] = {}
    exec(code, function.__globals__, names)
    result = names["factory"](**_HELPERS)
    for name in ("__qualname__", "__annotations__", "__doc__"):
        setattr(result, name, getattr(function, name))
    return result


_POINTERS = {"ptr8": _Pointer("B"), "ptr16": _Pointer("H"), "ptr32": _Pointer("i")}
# The known view of an array, or a new one; for a known one no Python function is called.
_KNOWN_VIEW = "viper_{0}(viper_id({1})) or {0}({1})"
# The statements that replace annotations.
_POINTER_CASTS = {t: "{0} = " + _KNOWN_VIEW.format(t, "{0}") for t in _POINTERS}
_INT_CHECKS = {"int": "{0} = viper_int({0})", "uint": "{0} = viper_int({0}, 0, 1 << 32)"}
_HELPERS: dict[str, Any] = {
    "viper_id": id,
    "viper_int": _int,
    "viper_count": _shift_count,
    "viper_index": _index,
    **{f"viper_{t}": pointer.views.get for t, pointer in _POINTERS.items()},
}

for _name, _builtin in (*_POINTERS.items(), ("uint", _uint)):
    setattr(builtins, _name, _builtin)
