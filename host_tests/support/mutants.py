"""Count the small faults in the firmware that the tests find: `make mutants COUNT=60 SEED=1`.

Each mutant is the tree with one change in firmware/: an operator replaced, a constant incremented,
a condition negated, a statement removed. The first ring runs on it until a test fails: first the
files named after the module, then those of the whole machine; with --all the second ring. Prints
the mutants that no test found.
"""

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
FIRMWARE = ROOT / "firmware"

# In this order: tests that play whole conversations find the most.
_ALL = [
    "host_tests/whole/test_conformance.py",
    "host_tests/talk/test_conversation.py",
    *(f"host_tests/whole/test_{name}.py" for name in ("laws", "injection")),
    "host_tests/language/test_interpreter.py",
    "host_tests",
]

_APART = ("emulator", "senders", "web")  # they need more than this computer has

_TURNED: "dict[type[ast.AST], str]" = {
    ast.Lt: "<=",
    ast.LtE: "<",
    ast.Gt: ">=",
    ast.GtE: ">",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "+",
    ast.BitAnd: "|",
    ast.BitOr: "&",
    ast.LShift: ">>",
    ast.RShift: "<<",
    ast.And: "or",
    ast.Or: "and",
}


class Mutant(NamedTuple):
    """A change: in this file, between these offsets of its text, to this text."""

    file: Path
    begin: int
    end: int
    text: str

    def source(self) -> str:
        """Return the file with the change."""
        old = self.file.read_text(encoding="utf-8")
        return old[: self.begin] + self.text + old[self.end :]

    def __str__(self) -> str:
        old = self.file.read_text(encoding="utf-8")
        line = old.count("\n", 0, self.begin) + 1
        was = old[self.begin : self.end]
        return f"{self.file.relative_to(ROOT)}:{line}: {was!r} -> {self.text!r}"


def mutants(file: Path) -> Iterator[Mutant]:
    """Yield every possible change in a file."""
    text = file.read_text(encoding="utf-8")
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def place(node: "ast.expr | ast.stmt") -> "tuple[int, int]":
        return (
            starts[node.lineno - 1] + node.col_offset,
            starts[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0),
        )

    for node in _that_run(ast.parse(text)):
        if isinstance(node, (ast.Expr, ast.Assign, ast.AugAssign)):
            if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
                yield Mutant(file, *place(node), "pass")
        elif isinstance(node, ast.Constant) and type(node.value) is int:
            yield Mutant(file, *place(node), str(node.value + 1))
        elif isinstance(node, (ast.If, ast.While)):
            begin, end = place(node.test)
            yield Mutant(file, begin, end, f"not ({text[begin:end]})")
        for left, operator, right in _operators(node):
            if type(operator) in _TURNED:
                begin, end = place(left)[1], place(right)[0]
                between = re.search(r"[^\s()\\]+", text[begin:end])
                if between:
                    at = begin + between.start()
                    yield Mutant(file, at, begin + between.end(), _TURNED[type(operator)])


def _operators(node: ast.AST) -> "Iterator[tuple[ast.expr, ast.AST, ast.expr]]":
    if isinstance(node, ast.BinOp):
        yield node.left, node.op, node.right
    elif isinstance(node, ast.Compare) and len(node.ops) == 1:
        yield node.left, node.ops[0], node.comparators[0]
    elif isinstance(node, ast.BoolOp):
        yield node.values[0], node.op, node.values[1]


def _that_run(node: ast.AST) -> Iterator[ast.AST]:
    """Yield all nodes that are executed: no annotations, nothing that only mypy reads."""
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        return
    if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "TYPE_CHECKING":
        return
    yield node
    for name, value in ast.iter_fields(node):
        if name not in ("annotation", "returns", "decorator_list"):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _that_run(child)


def copy_of_tree(folder: Path) -> Path:
    """Copy the working tree with everything that a test needs."""
    root = folder / "ugrbl"
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    for name in subprocess.check_output(listed, cwd=ROOT, text=True).splitlines():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, root / name)
    if (ROOT.parent / "shared").is_dir():
        (folder / "shared").symlink_to(ROOT.parent / "shared")
    (folder / "site").mkdir()
    (folder / "site" / "ugrbl").symlink_to(root / "tools")  # before the installed package
    return root


def is_found(root: Path, mutant: Mutant, whole: bool) -> "str | None":
    """Return the first test that fails; None if all pass."""
    file = root / mutant.file.relative_to(ROOT)
    before = file.read_text(encoding="utf-8")
    file.write_text(mutant.source(), encoding="utf-8")
    try:
        stem = re.sub(r"_kernel$|_chip$", "", mutant.file.stem)
        found = root.glob(f"host_tests/*/test_*{stem}*.py")
        named = sorted(str(test) for test in found if test.parent.name not in _APART)
        return (_failure(root, named, whole) if named else None) or _failure(root, _ALL, whole)
    finally:
        file.write_text(before, encoding="utf-8")


def _failure(root: Path, tests: "list[str]", whole: bool) -> "str | None":
    command = [sys.executable, "-m", "pytest", "-q", "-x", "--seed=1", "-p", "no:cacheprovider"]
    environment = {**os.environ, "PYTHONPATH": str(root.parent / "site")}
    done = subprocess.run(
        [*command, *(["--all"] if whole else []), *tests],
        cwd=root,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode in (0, 5):
        return None
    lines = re.findall(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.M)
    return lines[0] if lines else done.stdout.strip().splitlines()[-1]


def main() -> None:
    """Make mutants, run the tests, print the list."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--all", action="store_true", help="by the second ring")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    asked = parser.parse_args()
    every = [mutant for file in sorted(FIRMWARE.rglob("*.py")) for mutant in mutants(file)]
    chosen = random.Random(asked.seed).sample(every, asked.count)
    with TemporaryDirectory() as folder, ThreadPoolExecutor(asked.jobs) as pool:
        roots: "SimpleQueue[Path]" = SimpleQueue()
        for number in range(asked.jobs):
            roots.put(copy_of_tree(Path(folder) / str(number)))

        if failed := _failure(Path(folder) / "0" / "ugrbl", _ALL, asked.all):
            raise SystemExit(f"Without any change {failed} fails: mend that first.")

        def look(mutant: Mutant) -> bool:
            root = roots.get()
            found = is_found(root, mutant, asked.all)
            roots.put(root)
            print(f"{'found' if found else 'NOT FOUND'} {mutant} {found or ''}", flush=True)
            return bool(found)

        found = sum(pool.map(look, chosen))
    print(f"{found} of {len(chosen)} found, seed {asked.seed}")


if __name__ == "__main__":
    main()
