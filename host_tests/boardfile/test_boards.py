"""Test board files: every existing one is valid, and every mistake is named."""

import re
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from ugrbl.boardfile import rates
from ugrbl.boardfile.board_check import is_simulated, notes, problems
from ugrbl.boardfile.chips import CHIPS
from ugrbl.boardfile.files import BoardFileError, boards, load_board, load_for_build
from ugrbl.paths import BOARDS
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig

REAL = [name for name in boards() if hasattr(load_board(name), "DIR")]

GOOD: dict[str, Any] = {
    "CHIP": "pico",
    "MPY_ARCH": "armv6m",
    "ENGINE": "pio",
    "STEP": (2, 3, 4),
    "DIR": (5, 6, 7),
    "LIMIT": (9, 10, 11),
    "CONTROL": (None, 14, None, None),
    "DEFAULTS": {100: 800.0},
}

PICO2_W = {"CHIP": "pico2_w", "MPY_ARCH": "armv7emsp", "LINK": "wifi", "PAGE": True}


PUNCH = {
    "TOOL": "punch",
    "PUNCH_DOWN": 20,
    "PUNCH_UP": 21,
    "REPL_PIN": None,
    "PUNCH_DOWN_SENSOR": 22,
    "PUNCH_UP_SENSOR": 26,
    "SPINDLE_PWM": None,
    "SPINDLE_DIR": None,
}
OF_48: dict[str, Any] = {"CHIP": "rp2350b", "MPY_ARCH": "armv7emsp"}  # 48 pins
WIFI: dict[str, Any] = {
    "CHIP": "pico_w",
    "LINK": "wifi",
    "TOOL": "laser",
    "SPINDLE_PWM": 16,
}
EIGHT: dict[str, Any] = {  # motors
    **OF_48,
    "MOTORS": "XYZABCXY",
    "STEP": tuple(range(8)),
    "DIR": (*range(8, 14), 15, 16),
    "LIMIT": (17, 18, 19, 20, 21, 22, None, 26),
    "SPINDLE_PWM": 35,
    "FLOOD": 46,
}


def board(**changes: Any) -> ModuleType:
    """Return a board module like GOOD with these changes; None: without the option."""
    module = ModuleType("made")
    for name, value in {**GOOD, **changes}.items():
        if value is not None:
            setattr(module, name, value)
    return module


@pytest.mark.parametrize("name", REAL)
def test_every_existing_board_is_valid(name: str) -> None:
    assert problems(load_board(name)) == []


@pytest.mark.parametrize("name", REAL)
def test_board_has_a_description_and_the_arch_of_its_chip(name: str) -> None:
    module: Any = load_board(name)
    assert module.__doc__ and module.__doc__.strip().endswith(".")
    assert not hasattr(module, "CHIP") or CHIPS[module.CHIP].mpy_arch == module.MPY_ARCH


@pytest.mark.parametrize("name", ["rpi_pico_w", "rpi_pico2"])
def test_all_picos_are_wired_alike(name: str) -> None:
    """A board file cannot import another one, so the wiring is repeated in each."""
    pico, other_pico = vars(load_board("rpi_pico")), vars(load_board(name))
    # all options but those of the chip
    names = {key for key in (*pico, *other_pico) if key.isupper()} - {
        "CHIP",
        "MPY_ARCH",
        "PLANNER_BLOCKS",
    }
    assert {key: other_pico[key] for key in names} == {key: pico[key] for key in names}


@pytest.mark.parametrize("name", REAL)
def test_board_is_data_only(name: str) -> None:
    """Options in capital letters with plain values: no functions, classes or imports."""
    module = load_board(name)
    values = {key: value for key, value in vars(module).items() if not key.startswith("_")}
    allowed = (int, float, str, tuple, dict, bool)
    assert all(key.isupper() and isinstance(value, allowed) for key, value in values.items())


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"DIR": (5, 6, 2)}, "DIR: pin 2 is STEP already"),
        ({"PROBE": 14}, "HOLD: pin 14 is PROBE already"),
        ({"REPL_PIN": 3}, "REPL_PIN: pin 3 is STEP already"),
        ({"LIMIT": (9, 9, 11)}, "LIMIT: X and Y share a pin and are homed together: write HOM"),
        ({"PROBE": 23}, "PROBE: Raspberry Pi Pico has no pin 23 to connect to"),
        ({"ENABLE": (8, 30)}, "ENABLE: Raspberry Pi Pico has no pin 30 to connect to"),
        ({"ENABLE": (8, 4)}, "ENABLE: pin 4 is STEP already"),
        ({"DIR": (5, 6)}, "DIR needs 3 pins, not 2"),
        ({"STEP": (2, 3), "DIR": (5, 6), "LIMIT": None}, "STEP needs 3 pins, for XYZ"),
        ({"STEP": (2, 3, 4, 8, 12, 20, 21)}, "pio drives 6 motors at most"),
        ({**OF_48, "STEP": tuple(range(19, 28))}, "pio drives 8 motors at most"),
        ({**EIGHT, "MOTORS": None}, "STEP has 8 pins, but there are 6 axes: name the axis"),
        ({**EIGHT}, ""),
        ({**EIGHT, "STEP": (*range(13, 20), 32)}, "STEP: pin 32 cannot do it: steps, direct"),
        ({**EIGHT, "PROBE": 47}, "PROBE: pin 47 cannot do it: steps, directions, limits, probe"),
        ({**EIGHT, "CONTROL": (None, 40, None, None)}, "HOLD: pin 40 cannot do it"),
        ({**EIGHT, "CHIP": "pico2_w", "FLOOD": None}, "Raspberry Pi Pico 2 W has no pin 35 to co"),
        ({**EIGHT, "CHIP": None, "FLOOD": None}, "RP2350 on a board of its own has no pin 35 to"),
        ({**EIGHT, "TOOL": "laser"}, "TOOL = laser: its beam takes what a motor takes, and leav"),
        ({**WIFI, "STEP": (19, 20, 21, 22), "DIR": (26, 27, 28, 6), "LIMIT": None}, ""),
        (
            {**WIFI, "STEP": (19, 20, 21, 22, 7), "DIR": (26, 27, 28, 6, 8), "LIMIT": None},
            'TOOL = laser: LINK = "wifi" allows 4 motors at most',
        ),
        ({"CONTROL": (14,)}, "CONTROL needs four entries"),
        ({"SAFETY_DOOR": True}, "SAFETY_DOOR is set and there is no pin for the door"),
        ({"PWM_MAX": 65535}, "PWM_MAX is 65535: it is 16383 at the most"),
        ({"ESTOP": 14}, "HOLD: pin 14 is ESTOP already"),
        ({"OUTPUTS": {"vacuum": 2}}, "OUTPUTS: pin 2 is STEP already"),
        ({"OUTPUTS": {"lamp": 27}, "INPUTS": {"door": 27}}, "INPUTS: pin 27 is OUTPUTS already"),
        ({"INVERT": "FLOOD"}, "INVERT is 'FLOOD' but needs parentheses and a comma"),
        ({"INVERT": ("ENABLE",)}, "INVERT: 'ENABLE' is not one of SPINDLE_PWM, SPINDLE_ON"),
        ({"INVERT": ("FLOOD",)}, "INVERT: there is no pin for FLOOD"),
        ({"INVERT": ("FLOOD",), "FLOOD": 18}, ""),
        ({"CONTROL_INVERT": 2}, ""),
        ({"CONTROL_INVERT": 1}, "CONTROL_INVERT: there is no pin for RESET, so it"),
        ({"CONTROL_INVERT": 16}, "CONTROL_INVERT is 16: it is 15 at the most"),
        ({"CONTROL_INVERT": "2"}, "CONTROL_INVERT is '2': it must be a whole number"),
        ({"LIMIT_DEBOUNCE_MS": 6}, "LIMIT_DEBOUNCE_MS is 6: it is 5 at the most"),
        ({"WATCHDOG_MS": 9000}, "WATCHDOG_MS is 9000: it is 8388 at the most"),
        ({"LOOP_MS": 20}, "LOOP_MS is 20: it is 100 at the least"),
        ({"DEFAULTS": {0: 1}}, "DEFAULTS: $0=1 is refused"),
        ({"ENGINE": "rmt"}, "ENGINE 'rmt' does not run on MPY_ARCH 'armv6m'"),
        ({"ENGINE": "steam"}, "ENGINE: 'steam' is not one of"),
        ({"CHIP": "potato"}, "CHIP: 'potato' is not one of"),
        ({"LINK": "pigeon"}, "LINK: 'pigeon' is not one of usb, uart"),
        ({"STEP": 2}, "STEP is 2 but needs parentheses"),
        ({"ENABLE": "GP8"}, "ENABLE is 'GP8': pins are numbers"),
        ({"PWM_MAX": "1000"}, "PWM_MAX is '1000': it must be a whole number"),
        ({"DEFAULTS": (100, 800)}, "DEFAULTS is (100, 800) but must have the form"),
        ({"SPINDEL_PWM": 16}, "SPINDEL_PWM: no such option; did you mean SPINDLE_PWM?"),
        ({"ENGINE": "i2s", "MPY_ARCH": "xtensawin", "CHIP": "esp32"}, "ENABLE is missing"),
        ({"DIALECT": "0.7"}, "DIALECT: '0.7' is not one of 1.1, 0.9, 0.9i, 0.9j, hal"),
        ({"DIALECT": 0.9}, 'DIALECT is 0.9 but needs quotation marks: "0.9"'),
        ({"TOOL": "hammer"}, "TOOL: 'hammer' is not one of spindle, laser, punch"),
        ({"TOOL": "punch", "PUNCH_UP": 20}, "no pin for PUNCH_DOWN, PUNCH_DOWN_SENSOR, PUNCH_UP_"),
        ({**PUNCH, "OUTPUTS": {"lamp": 28}}, "OUTPUTS: not possible with TOOL = punch"),
        ({"DIR": None}, "DIR is missing"),
        ({"DIR": None, "ENGINE": "sim"}, ""),
        ({"ENGINE": "sim", "LOOP_US": "200"}, "LOOP_US is '200': it must be a whole number"),
        ({"CHIP": "pico2"}, "CHIP 'pico2' has MPY_ARCH 'armv7emsp'"),
        ({"MIST": 1}, "MIST is 1: it must be True or False"),
        ({"SD_CARD": (26, 27, 28, 21), "JOBS": "jobs"}, ""),
        ({"SD_CARD": (26, 27, 28, 14), "JOBS": "jobs"}, "SD_CARD: pin 14 is HOLD already"),
        ({"SD_CARD": (26, 27, 28, 21)}, 'SD_CARD is for jobs: add JOBS = "jobs"'),
        ({"SD_CARD": (26, 27, 28), "JOBS": "jobs"}, "SD_CARD needs four pins: clock, to the"),
        ({"SD_CARD": (26, 27, 20, 21), "JOBS": "jobs"}, "SD_CARD: 26, 27, 20 are not SCK, TX"),
        ({"SD_CARD": (26, 28, 27, 21), "JOBS": "jobs"}, "SD_CARD: 26, 28, 27 are not SCK, TX"),
        ({"POWER_FAIL": 0}, ""),
        ({"POWER_FAIL": 14}, "POWER_FAIL: pin 14 is HOLD already"),
        ({"POWER_FAIL": 20, "POWER_FAIL_MS": 5}, "POWER_FAIL_MS is 5: it is 20 at the least"),
        ({"PAGE": True}, "PAGE: a Pico W has less than 40 kB of memory left with it: take"),
        ({"PAGE": True, "LINK": "wifi"}, "from `ugrbl web`, or a Pico 2 W or an ESP32"),
        ({**PICO2_W, "LINK": "usb"}, 'PAGE: it needs a network, LINK = "wifi", or'),
        (PICO2_W, ""),
        ({"PAGE": True, "ENGINE": "sim", "MPY_ARCH": None}, "PAGE: it needs a network"),
        ({"PAGE": 1}, "PAGE is 1: it must be True or False"),
        ({"EXTRAS": ("nowhere",)}, "EXTRAS: No module named 'nowhere'"),
    ],
)
def test_mistake_is_named(changes: "dict[str, Any]", said: str) -> None:
    """said: what the only problem contains; "": there is no problem."""
    found = problems(board(**changes))
    assert (said in found[0] and len(found) == 1) if said else found == []


@pytest.mark.parametrize(
    ("options", "refused"),
    [
        ({"JERK": True, "DEFAULTS": {800: 2000}}, ""),
        ({"DEFAULTS": {800: 2000}}, "$800=2000 is refused"),
        ({"JERK": True, "DEFAULTS": {800: -1}}, "$800=-1 is refused"),
        ({"SKEW": True, "DEFAULTS": {780: -1.5}}, ""),
    ],
)
def test_defaults_are_only_for_settings_of_the_board(
    options: "dict[str, Any]", refused: str
) -> None:
    """$800 exists with JERK only, $780 with SKEW. refused: part of the problem; "": none."""
    found = problems(board(**options))
    assert len(found) == bool(refused) and all(refused in text for text in found), found


@pytest.mark.parametrize("text", ["def install(cnc:\n", "1 / 0\n"])
def test_extra_that_fails_is_reported(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A syntax error, or an exception at import."""
    (tmp_path / "broken.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    (problem,) = problems(board(EXTRAS=("broken",)))
    assert problem.startswith(
        ("EXTRAS: a module fails: SyntaxError: ", "EXTRAS: a module fails: Zero")
    )


def test_extra_that_imports_the_firmware_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A board has only the modules that its options need; extras.api and time are always there."""
    (tmp_path / "greedy.py").write_text(
        "from base.errors import GrblError\nimport extras.api, time\ndef install(cnc): pass\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    assert problems(board(EXTRAS=("greedy",))) == [
        "EXTRAS: greedy imports base.errors, which boards may not "
        "have: use only `cnc` and what boards have"
    ]


def test_extra_and_custom_module_need_different_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.py").write_text("def install(cnc): pass\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert problems(board(EXTRAS=("mine",), CUSTOM="mine")) == [
        "CUSTOM is 'mine': EXTRAS has a module of that name; choose another name"
    ]
    assert not problems(board(EXTRAS=("mine",)))


def test_pins_that_affect_the_start_are_reported() -> None:
    """notes() lists what is possible, but may surprise: pin 12 of an ESP32 decides its flash
    voltage at start, a WROVER module uses pins 16 and 17."""
    esp32_uno = ModuleType("board")
    shield = {"STEP": (26, 25, 17), "DIR": (16, 27, 14)}
    esp32_uno.__dict__.update({**vars(load_board("esp32_devkit")), **shield})
    found_notes = notes(esp32_uno)
    enable = next(text for text in found_notes if text.startswith("ENABLE: pin 12 "))
    assert "does not start" in enable and "CNC shield" in enable
    wrover = [text.split(":")[0] for text in found_notes if "WROVER" in text]
    assert wrover == ["STEP", "DIR"]
    assert not any("WROVER" in text for text in notes(load_board("esp32_devkit")))
    assert notes(load_board("rpi_pico")) == notes(load_board("sim")) == []
    assert notes(board(DEFAULTS={100: 0, 110: 500, 130: 0})) == [
        "DEFAULTS: $100=0 means 0 steps/mm for X: it will not move as it should"
    ]
    # 0 and 5 are outputs of its shift register, not pins
    assert not any("pin 0 " in text or "pin 5 " in text for text in notes(load_board("mks_dlc32")))


def test_two_boards_with_one_name_start_with_their_own_settings() -> None:
    for steps in (100.0, 80.0):
        board = ModuleType("board")
        board.__dict__.update({**vars(load_board("sim")), "DEFAULTS": {100: steps}})
        assert f"$100={steps:g}" in factory_store(board).files["settings"]


def test_simulators_board_file_is_checked_too(tmp_path: Path) -> None:
    """PWM_MAX has a default. LINK "uart" is possible without a chip."""
    sim = (BOARDS / "sim.py").read_text("utf-8")
    file = tmp_path / "mine.py"
    file.write_text(re.sub(r"(?m)^PWM_MAX.*$", 'LINK = "uart"', sim))
    board = load_board(str(file))
    assert rates.intake(board).bytes_s == 0
    assert Rig(board, factory_store(board)).port.pwm_max == 1000
    file.write_text(sim + 'PWM_MAX = "much"\n')
    with pytest.raises(BoardFileError, match="PWM_MAX"):
        load_board(str(file))


def test_simulator_accepts_a_users_board_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text((BOARDS / "sim.py").read_text("utf-8"), "utf-8")
    assert is_simulated(load_board(str(file)))
    with pytest.raises(BoardFileError, match="and has no pins"):
        load_for_build(file)


def test_missing_option_of_an_engine_is_named() -> None:
    made = board(STEP=None)
    assert problems(made) == ["STEP is missing"]
