"""MicroPython's own modules are imported without a look at the file system."""

import ast

import pytest
from ugrbl.compiling import build
from ugrbl.compiling.built_in import built_in


@pytest.mark.parametrize(
    ("text", "made"),
    [
        ("import array\n", "import uarray as array\n"),
        ("import array as a, micropython\n", "import uarray as a, micropython\n"),
        ("from machine import Pin, mem32\n", "from umachine import Pin, mem32\n"),
        ("import sys; import os\nx = 1\n", "import sys; import uos as os\nx = 1\n"),
        ("def f():\n    import time  # later\n", "def f():\n    import utime as time  # later\n"),
        ("from motion import layout\n", "from motion import layout\n"),
    ],
)
def test_an_import_names_micropythons_own_module(text: str, made: str) -> None:
    assert built_in(text) == made


def test_no_board_looks_for_one_in_its_files() -> None:
    looked_for = []
    for text in build.prepared_firmware().texts.values():
        made = built_in(text)
        assert made.count("\n") == text.count("\n")
        for node in ast.walk(ast.parse(made)):
            if isinstance(node, ast.Import):
                looked_for += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                looked_for.append(node.module or "")
    assert not {"array", "io", "machine", "os", "select", "time", "binascii"} & {*looked_for}
    assert "uarray" in looked_for
