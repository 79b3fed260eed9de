"""The interpreter's tables. What it does with lines: test_gcode_oracle.py and the recordings."""

import subprocess
import sys

import pytest
from ugrbl.paths import FIRMWARE, STANDINS


@pytest.mark.parametrize("row", ["GROUP_1, 'motion', 81", "GROUP_0, None, 81"])
def test_a_row_without_a_behaviour_is_found_at_import(row: str) -> None:
    """It would be a probing move, or nothing."""
    program = (
        f"import sys; sys.path[:0] = [{str(STANDINS)!r}, {str(FIRMWARE)!r}]\n"
        "import language.interpreter; del sys.modules['language.interpreter']\n"
        "from language.block import *\n"
        f"G_WORDS[81] = ({row}, AXES_MOTION)\n"
        "import language.interpreter\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1 and "without a behaviour" in done.stderr
