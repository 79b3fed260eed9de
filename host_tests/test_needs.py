"""Which MicroPython the engines want: the table, at start and in the tools."""

import sys
from types import SimpleNamespace

import pytest
from boot import needs


@pytest.mark.parametrize(
    ("engine", "machine", "oldest"),
    [
        ("pio", "Raspberry Pi Pico with RP2040", (1, 26)),
        ("pio", "Raspberry Pi Pico2 with RP2350", (1, 27)),
        ("rmt", "Generic ESP32S3 module with ESP32S3", (1, 27)),
        ("i2s", "Generic ESP32 module with ESP32", (1, 23)),
    ],
)
def test_an_engine_is_refused_below_its_version_and_not_from_there_on(
    engine: str, machine: str, oldest: "tuple[int, int]"
) -> None:
    assert needs.missing(engine, machine, oldest) == ""
    assert needs.missing(engine, machine, (2, 0)) == ""
    why = needs.missing(engine, machine, (oldest[0], oldest[1] - 1))
    assert f"wants {oldest[0]}.{oldest[1]} or newer" in why
    for word in ("ok", "error"):
        assert word not in why.lower()


def test_the_firmware_refuses_to_start_and_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    old = SimpleNamespace(version=(1, 25, 0, ""), _machine="Raspberry Pi Pico with RP2040")
    monkeypatch.setattr(needs, "sys", SimpleNamespace(implementation=old))
    with pytest.raises(ValueError, match=r"MicroPython 1\.25 is too old"):
        needs.check("pio")
    needs.check("i2s")  # which is none of this chip's: somebody else says so
    monkeypatch.setattr(needs, "sys", sys)
    needs.check("pio")
