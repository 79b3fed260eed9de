"""Test the table of engines: what each needs from the board file and MicroPython at a start."""

import sys
from types import ModuleType, SimpleNamespace

import pytest
from boot import parts


@pytest.mark.parametrize(
    ("engine", "machine", "oldest"),
    [
        ("pio", "Raspberry Pi Pico with RP2040", (1, 26)),
        ("pio", "Raspberry Pi Pico2 with RP2350", (1, 27)),
        ("rmt", "Generic ESP32S3 module with ESP32S3", (1, 27)),
        ("i2s", "Generic ESP32 module with ESP32", (1, 27)),
    ],
)
def test_engine_is_refused_only_below_its_oldest_version(
    engine: str, machine: str, oldest: "tuple[int, int]"
) -> None:
    """too_old() returns a text, or "". The text must not look like an answer to a sender."""
    assert parts.too_old(engine, machine, oldest) == ""
    assert parts.too_old(engine, machine, (2, 0)) == ""
    text = parts.too_old(engine, machine, (oldest[0], oldest[1] - 1))
    assert f"needs {oldest[0]}.{oldest[1]} or newer" in text
    for word in ("ok", "error"):
        assert word not in text.lower()


def board(engine: str, *left_out: str) -> ModuleType:
    """Return a board with what any engine needs, without these options."""
    module = ModuleType("board")
    options = {"ENGINE": engine, "STEP": (1,), "DIR": (2,), "ENABLE": 3, "I2S": (4, 5, 6)}
    options |= {"I2S_RATE_HZ": 125_000, "I2S_BUFFERS": 16}
    vars(module).update({name: value for name, value in options.items() if name not in left_out})
    return module


def test_firmware_refuses_to_start_and_names_the_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    old = SimpleNamespace(version=(1, 25, 0, ""), _machine="Raspberry Pi Pico with RP2040")
    monkeypatch.setattr(parts, "sys", SimpleNamespace(implementation=old))
    with pytest.raises(ValueError, match=r"MicroPython 1\.25 is too old"):
        parts._check_engine(board("pio"))
    parts._check_engine(board("i2s"))  # not an engine of this chip: another check refuses it
    monkeypatch.setattr(parts, "sys", sys)  # the Python of this computer is new enough
    parts._check_engine(board("pio"))


@pytest.mark.parametrize(
    ("engine", "left_out", "said"),
    [
        ("steam", (), "ENGINE must be i2s, pio or rmt, not steam"),
        ("pio", ("DIR",), "ENGINE = pio requires DIR"),
        ("i2s", ("I2S", "ENABLE"), "ENGINE = i2s requires ENABLE, I2S"),
    ],
)
def test_missing_options_of_the_board_file_are_named(
    engine: str, left_out: "tuple[str, ...]", said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        parts._check_engine(board(engine, *left_out))


def test_unknown_link_is_named() -> None:
    with pytest.raises(ValueError, match="LINK must be uart, uart_wifi, usb or wifi, not pigeon"):
        parts._link("pigeon")
