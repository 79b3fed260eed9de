"""Make the standard library for mypy: CPython's stubs, with MicroPython's additions appended.

Usage: merge.py OUTPUT. Each .pyi file in this folder extends the stub of the same name.
"""

import shutil
import sys
from pathlib import Path

import mypy


def main(output: Path) -> None:
    shutil.rmtree(output, ignore_errors=True)
    shutil.copytree(Path(mypy.__file__).parent / "typeshed", output)
    for addition in Path(__file__).parent.glob("*.pyi"):
        module = output / "stdlib" / addition.name
        if not module.exists():
            module = output / "stdlib" / addition.stem / "__init__.pyi"
        with module.open("a") as stub:
            stub.write("\n" + addition.read_text())


main(Path(sys.argv[1]))
