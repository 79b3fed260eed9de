"""What pyproject.toml cannot say: which folders beside tools/ travel in the package."""

from pathlib import Path

from setuptools import setup

FOLDERS = {
    "ugrbl": "tools",
    "ugrbl.firmware": "firmware",
    "ugrbl.boards": "boards",
    "ugrbl.examples": "examples",
}


def package_dir() -> dict[str, str]:
    found = {}
    for package, folder in FOLDERS.items():
        for path in (Path(folder), *Path(folder).rglob("*")):
            if path.is_dir() and path.name != "__pycache__":
                parts = path.relative_to(folder).parts
                found[".".join((package, *parts))] = path.as_posix()
    return found


found = package_dir()
setup(packages=list(found), package_dir=found, package_data={"": ["*"]})
