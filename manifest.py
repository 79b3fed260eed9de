"""For MicroPython's build: what a board has anyway, and this firmware, frozen in.

    make -C ports/rp2 BOARD=RPI_PICO FROZEN_MANIFEST=…/ugrbl/manifest.py

The firmware is compiled for the chip of boards/rpi_pico.py then, and does for every board file
with that chip; UGRBL_BOARD names another, or has the path of yours.
"""

import os
import shutil
import subprocess

# What `make` is told is in the environment, too.
board = os.environ.get("UGRBL_BOARD") or os.environ.get("BOARD", "").lower()
if not board:
    raise ValueError("for which board? UGRBL_BOARD=NAME, a file of boards/, or a path")

ugrbl = ".venv/bin/ugrbl" if os.path.exists(".venv/bin/ugrbl") else shutil.which("ugrbl")
if not ugrbl:
    raise ValueError(f"ugrbl is not installed: make .venv/installed, in {os.getcwd()}")
folder = os.path.abspath("build/frozen/" + os.path.splitext(os.path.basename(board))[0])
command = [ugrbl, "build", "--frozen", "--board", board, "--out", folder]
done = subprocess.run(command, capture_output=True, text=True, check=False)
if done.returncode:
    raise ValueError(done.stderr.strip())

try:
    include("$(BOARD_DIR)/manifest.py")
except Exception as error:
    # It has none of its own? What is missing deeper down has two such lines.
    if "No such file" not in str(error) or str(error).count("Error in manifest file") != 1:
        raise
    include("$(PORT_DIR)/boards/manifest.py")
freeze_mpy(folder)
