"""Install the senders under test into a separate folder, from their registries.

    python install.py [FOLDER]

The default folder is ~/.cache/ugrbl-senders, or UGRBL_SENDERS; an existing installation is kept.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

FOLDER = Path(os.environ.get("UGRBL_SENDERS") or Path.home() / ".cache" / "ugrbl-senders")

CNCJS = "cncjs@1.11.5"
# bCNC's other requirements (OpenCV, Pillow, tkinter-gl …) serve its windows and its camera.
PYTHON_SENDERS = ("bCNC==0.9.16", "grbl-streamer==2.0.2")
PYTHON_NEEDS = ("pyserial==3.5", "gcode-machine==1.0.3", "numpy", "svgelements<2", "shxparser")

_PATIENCE_S = 600


class NotInstalled(Exception):
    """A sender cannot be installed here; the text says why."""


def cncjs() -> Path:
    """Return the folder of cncjs; install it if needed."""
    home = FOLDER / "cncjs"
    package = home / "node_modules" / "cncjs"
    if not (package / "package.json").exists():
        npm = shutil.which("npm")
        if npm is None or shutil.which("node") is None:
            raise NotInstalled("cncjs needs Node.js and npm")
        home.mkdir(parents=True, exist_ok=True)
        # Its native part is prebuilt; install scripts would only build it again.
        _run(
            [
                npm,
                "install",
                "--prefix",
                home,
                "--no-audit",
                "--no-fund",
                "--ignore-scripts",
                CNCJS,
            ]
        )
    return package


def python() -> Path:
    """Return a Python with the senders of PyPI; make it if needed."""
    home = FOLDER / "python"
    interpreter = home / "bin" / "python"
    done = home / "installed"
    wanted = " ".join(PYTHON_SENDERS + PYTHON_NEEDS)
    if not done.exists() or done.read_text() != wanted:
        home.parent.mkdir(parents=True, exist_ok=True)
        _run([sys.executable, "-m", "venv", home])
        pip = [interpreter, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        _run([*pip, *PYTHON_NEEDS])
        _run([*pip, "--no-deps", *PYTHON_SENDERS])
        done.write_text(wanted)
    return interpreter


def _run(command: list[object]) -> None:
    words = [str(word) for word in command]
    try:
        done = subprocess.run(
            words, capture_output=True, text=True, timeout=_PATIENCE_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise NotInstalled(f"{words[0]}: {error}") from error
    if done.returncode:
        last = (done.stderr.strip() or done.stdout.strip()).splitlines()[-1:]
        raise NotInstalled(f"{' '.join(words[:4])} … failed: {''.join(last)}")


if __name__ == "__main__":
    for install in (cncjs, python):
        try:
            print(install())
        except NotInstalled as error:
            print(f"not installed: {error}", file=sys.stderr)
