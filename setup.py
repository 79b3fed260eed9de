"""What pyproject.toml cannot say: what is in the package beside tools/, some of it compiled."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

FOLDERS = {
    "ugrbl": "tools",
    "ugrbl.firmware": "firmware",
    "ugrbl.boards": "boards",
    "ugrbl.examples": "examples",
    "ugrbl.conversations": "host_tests/conversations",
}


def package_dir() -> dict[str, str]:
    found = {}
    for package, folder in FOLDERS.items():
        for path in (Path(folder), *Path(folder).rglob("*")):
            if path.is_dir() and path.name != "__pycache__":
                parts = path.relative_to(folder).parts
                found[".".join((package, *parts))] = path.as_posix()
    return found


class WithCompiledFirmware(build_py):
    """The package includes compiled firmware, so a user needs no compiler."""

    def run(self) -> None:
        # Else what an older build has left there would be in the package, too.
        shutil.rmtree(Path(self.build_lib, "ugrbl"), ignore_errors=True)
        super().run()
        if not self.editable_mode:
            where = os.pathsep.join([self.build_lib, os.environ.get("PYTHONPATH", "")])
            fill = "from ugrbl.compiling.build import fill_package; fill_package()"
            command = [sys.executable, "-c", fill]
            subprocess.run(command, check=True, env={**os.environ, "PYTHONPATH": where})


found = package_dir()
setup(
    packages=list(found),
    package_dir=found,
    package_data={"": ["*"]},
    cmdclass={"build_py": WithCompiledFirmware},
)
