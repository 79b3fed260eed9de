"""Test the setup of a board in the page, from an empty board to a machine that answers.

The board is a stand-in (PromptBoard): it has MicroPython's prompt, files in a folder, and, once
started, a simulated machine. `person.bridge.machine` is this board.

browser.py says what a person, a homer and the page's `grbl` and `job` are.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import Person
from prompt_stand_in import PromptBoard
from ugrbl import __version__
from ugrbl.boardfile import board_check
from ugrbl.boardfile.files import load
from ugrbl.paths import BOARDS

pytestmark = [pytest.mark.xdist_group("page"), pytest.mark.thorough]

_PICO = (BOARDS / "rpi_pico.py").read_text()


@pytest.fixture
def set_up(
    person_at: Callable[..., Person], machines: Callable[..., Any], tmp_path: Path
) -> Iterator[Callable[..., Person]]:
    """Return a function that opens the page from disk, with a board as its parameters say.

    The person it returns is not connected yet.
    """
    ends: "list[Callable[[], None]]" = []

    def make(has: str = "frozen", board: str = "", **options: Any) -> Person:
        """Open the page at a board.

        has: "frozen" (ugrbl is in the firmware), "frozen 0.0.9" (with that version) or "nothing".
        board: the content of its board.py; "": there is no such file. options: of the browser.
        """
        flash = tmp_path / "flash"
        flash.mkdir()
        if board:
            (flash / "board.py").write_text(board)
        person = person_at(**options)
        spare_machine = machines({})  # starts while the person reads
        made = PromptBoard(
            flash, lambda: spare_machine if spare_machine.is_new() else machines({}), has
        )
        ends.extend((made.close, spare_machine.close))
        person.bridge.machine = made  # type: ignore[assignment]
        person.open_from_disk()
        return person

    yield make
    for end in ends:
        end()


def flash_of(person: Person) -> Path:
    """Return the folder that stands for the board's flash memory."""
    return person.bridge.machine.folder  # type: ignore[attr-defined, no-any-return]


def step(person: Person, name: str) -> None:
    """Open a step of the setup."""
    if person.page.get_attribute("#tabs [data-tab=setup]", "aria-selected") != "true":
        person.click("#tabs [data-tab=setup]")
    person.click(f"#setup-steps [data-step={name}]")


def give(person: Person, **jobs: int) -> None:
    """Select for each pin number its job, by label: step_X=2 gives pin 2 the job `step X`."""
    for words, pin in jobs.items():
        person.page.select_option(f"#pin-{pin}", label=words.replace("_", " "))


# States of the board at first


@pytest.mark.sampled(1)
def test_board_without_board_file_leads_to_choice(set_up):
    """The setup recognizes the chip and offers boards with it. No machine runs, so STOP is off."""
    person = set_up()
    person.click("#connect")
    person.reads(
        "#setup-found",
        "on Raspberry Pi Pico with RP2040, with ugrbl and",
    )
    person.click("#setup-actions button")
    person.reads("#board-cards", "rpi_pico")
    assert person.page.input_value("#board-chip") == "pico"
    assert person.text("#state-name") == "Prompt" and not person.page.is_enabled("#stop")


@pytest.mark.parametrize(("installed", "is_other"), [("0.0.9", True), (__version__, False)])
def test_board_with_another_version_says_how_to_update(set_up, installed, is_other):
    """The page advises an update if the board has another version of ugrbl than the page."""
    person = set_up(f"frozen {installed}", board=_PICO)
    person.click("#connect")
    person.reads("#setup-found", "with ugrbl and a board file")
    advice = f"It is ugrbl {installed}; this page belongs to {__version__}."
    # The advice, and the name of the UF2 file to install, are shown only for another version.
    assert (
        (advice in person.text("#setup-found")) == is_other == person.page.is_visible("#uf2-name")
    )


def test_micropython_without_ugrbl_names_file_to_copy(set_up):
    """The name of the UF2 file and of the drive to copy it to follow the selected board."""
    person = set_up("nothing")
    person.click("#connect")
    # The board is a Pico; its name is proposed first.
    person.reads("#setup-found", "without ugrbl")
    assert person.page.is_visible("#uf2-name")
    assert person.text("#uf2-name") == "ugrbl-…-RPI_PICO.uf2"
    person.page.select_option("#uf2-board", "pico2_w")
    assert person.text("#uf2-name") == "ugrbl-…-RPI_PICO2_W.uf2"
    # The drive that a Pico 2 shows in its boot loader.
    assert person.text("#uf2-drive") == "RP2350"


def test_running_machine_continues_and_its_board_file_is_read(set_up):
    """Reading the file needs the prompt, so the idle machine is stopped and then restarted."""
    person = set_up(board=_PICO)
    person.bridge.machine.power_up()  # starts the machine before the page connects
    person.click("#connect")
    person.sees("Idle")
    person.knows_all()
    step(person, "connect")
    person.reads("#setup-found", "A machine is at work")
    person.click("text=Read its board file")
    person.waits(
        "document.getElementById('board-text').value.includes('Raspberry Pi Pico with three')"
    )
    person.sees("Idle")  # it was restarted
    person.knows_all()


def test_moving_machine_is_not_interrupted(set_up):
    """A board file is read at the prompt, which would end a motion, so the page refuses."""
    person = set_up(board=_PICO)
    person.bridge.machine.power_up()  # starts the machine before the page connects
    person.click("#connect")
    person.sees("Idle")
    person.knows_all()
    person.types("G1 X40 F600")
    person.sees("Run")
    step(person, "connect")
    person.click("text=Read its board file")
    person.reads("#setup-found", "The machine is in Run and is not disturbed")
    assert b"\x03" not in person.bridge.machine.sent  # Ctrl-C would end the machine


def test_silent_board_is_reported(set_up):
    """The board answers neither as a machine nor at the prompt."""
    person = set_up()
    person.bridge.machine.write = lambda data: None  # the board receives nothing
    person.click("#connect")
    step(person, "connect")
    person.reads("#setup-found", "The board says nothing")
    person.click("text=Look what is on it")
    person.reads("#setup-found", "prompt does not answer")


# From pins to a machine


def test_empty_board_becomes_machine_with_own_pins(set_up):
    """A board with its own pins, an output and an option is made in the page, sent, and runs."""
    person = set_up()
    person.click("#connect")
    person.reads("#setup-found", "without a board file")
    step(person, "board")
    person.click("text=My own")
    person.page.fill("#board-title", "Router")
    person.reads("#pins-says", "Still without a pin: step X, step Y")
    give(person, step_X=2, step_Y=3, step_Z=4, dir_X=5, dir_Y=6, dir_Z=7)
    person.reads("#pins-says", "No rule is broken")
    give(person, limit_X=9, limit_Y=10, limit_Z=11, probe=12)
    person.page.fill("#own-name", "vacuum")
    person.click("text=Add output")
    give(person, output_vacuum=20)
    step(person, "options")
    person.click("summary:has-text('Motors')")
    person.page.check("#option-JERK")
    step(person, "file")
    person.click("#send-board")
    person.reads("#file-says", "the machine runs")
    person.sees("Idle")
    board = load(flash_of(person) / "board.py")
    assert board_check.problems(board) == []
    assert (board.STEP, board.DIR, board.LIMIT) == ((2, 3, 4), (5, 6, 7), (9, 10, 11))
    assert (board.PROBE, board.OUTPUTS, board.JERK) == (12, {"vacuum": 20}, True)
    assert board.__doc__ == "Router: Raspberry Pi Pico."
    assert not (flash_of(person) / "new.py").exists()  # the temporary file of the transfer


def test_fault_is_shown_at_once_in_words_of_board_check(set_up):
    """The page finds the faults that the check in Python finds.

    A board with a fault cannot be sent.
    """
    person = set_up()
    step(person, "board")
    person.page.select_option("#board-chip", "esp32")
    person.click("text=My own")
    # Pin 34 has no output.
    give(person, step_X=34, step_Y=25, step_Z=26, dir_X=27, dir_Y=14, dir_Z=13)
    person.reads("#pins-says", "STEP: pin 34 of ESP32 is an input only: choose another")
    assert not person.page.is_enabled("#send-board")
    give(person, step_X=12)  # a strapping pin, read at power-up
    person.reads("#pins-says", "STEP: pin 12 pulled up at start selects the wrong flash voltage")
    assert person.page.input_value("#pin-34") == ""  # its job has moved to pin 12


def test_next_step_without_choice_begins_own_board(set_up):
    """Who chooses no board and goes on gets an empty one of their own."""
    person = set_up()
    step(person, "board")
    person.click("#step-next")
    give(person, step_X=2)
    step(person, "options")
    person.click("summary:has-text('Motors')")  # opens the group of options
    person.page.check("#option-JERK")
    step(person, "file")
    text = person.page.input_value("#board-text")
    assert "STEP = (2," in text and "JERK = True" in text


def test_second_motor_of_axis_has_own_pins(set_up):
    """A second Y motor is added to a known board.

    The choice remains selected when the step is opened again.
    """
    person = set_up()
    step(person, "board")
    person.click("#board-cards b:text-is('rpi_pico')")
    person.page.fill("#board-motors", "xyzy")
    person.page.keyboard.press("Tab")  # leaves the field, so it is read
    person.reads("#pins-says", "Still without a pin: step Y2, dir Y2")
    give(person, step_Y2=19, dir_Y2=20, limit_Y2=21)
    step(person, "file")
    step(person, "board")
    person.reads("#board-cards [aria-pressed=true] b", "rpi_pico")
    text = person.page.input_value("#board-text")
    assert 'MOTORS = "XYZY"' in text and "STEP = (2, 3, 4, 19)" in text
    assert "LIMIT = (9, 10, 11, 21)" in text


def test_entries_are_kept_when_page_is_reloaded(set_up):
    """The unfinished board is stored in the browser."""
    person = set_up()
    step(person, "board")
    person.click("text=My own")
    give(person, step_X=2)
    person.page.reload()
    person.click("#tabs [data-tab=setup]")
    assert person.page.is_visible("#module")
    # The job is stored as the pin's option and its index in it: motor 0.
    assert person.page.input_value("#pin-2") == "STEP 0"


# Faults


@pytest.fixture
def editor(set_up):
    """Return a person at the file step, connected to a Pico whose machine has not been started."""
    person = set_up(board=_PICO)
    person.click("#connect")
    person.reads("#setup-found", "The machine does not run")
    step(person, "file")
    return person


_MARKED = """(() => {
  const { value, selectionStart, selectionEnd } = document.getElementById("board-text");
  return value.slice(selectionStart, selectionEnd);
})()"""


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ('MPY_ARCH = "armv6m"\nSTEP = (2, 3\nDIR = 1\n', 3, "SyntaxError"),
        ('MPY_ARCH = "armv6m"\nSTEP = STEPS\n', 2, "NameError"),
        (_PICO + "\nJERK = True\nSKEW = True\n", len(_PICO.split("\n")) + 2, "SKEW and JERK"),
    ],
)
def test_fault_is_shown_with_its_line(editor, text, line, words):
    """The faulty line is named and selected.

    A file that fails in Python does not replace the old one.
    """
    editor.page.fill("#board-text", text)
    editor.click("#send-board")
    editor.reads("#file-says", f"Line {line}: ")
    editor.reads("#file-says", words)
    marked = editor.page.evaluate(_MARKED)
    # Lines are counted from 1.
    assert marked == text.split("\n")[line - 1]
    stored_text = (flash_of(editor) / "board.py").read_text()
    # The first two texts fail in Python; the third runs, but its options exclude each other.
    assert stored_text == (_PICO if "Error" in words else text), (
        "what Python does not take is not kept"
    )
    editor.click("text=Show the file that was there before")
    assert editor.page.input_value("#board-text") == _PICO


def test_file_damaged_on_its_way_does_not_replace_old_file(editor):
    """The bytes received are compared with those sent before the new file replaces the old one."""
    editor.bridge.machine.damage = (
        b"\\x58"  # lost on the wire: an X, as the sending script escapes it
    )
    editor.page.fill("#board-text", 'MPY_ARCH = "armv6m"  # X\n')
    editor.click("#send-board")
    editor.reads("#file-says", "the file was damaged on its way")
    assert (flash_of(editor) / "board.py").read_text() == _PICO


def test_file_for_another_chip_is_not_sent(editor):
    editor.page.fill("#board-text", 'MPY_ARCH = "xtensawin"\n')
    editor.click("#send-board")
    editor.reads("#file-says", "the file is for another chip")
    assert (flash_of(editor) / "board.py").read_text() == _PICO


# The user's Python code


def test_custom_py_is_sent_and_its_fault_is_marked(editor):
    """A fault in custom.py is shown at its line.

    A syntax error is found before the file is stored, another fault when the running machine
    reports it.
    """
    editor.page.select_option("#file-name", "custom.py")
    assert "from ugrbl import mcode" in editor.page.input_value("#board-text")
    editor.page.fill("#board-text", "from ugrbl import mcode\n@mcode(100\ndef f(m):\n    pass\n")
    editor.click("#send-board")
    editor.reads("#file-says", "SyntaxError")
    assert not (flash_of(editor) / "custom.py").exists()
    good = "from ugrbl import mcode\n\n@mcode(100)\ndef f(m):\n    1 / 0\n"
    editor.page.fill("#board-text", good)
    editor.click("#send-board")
    editor.reads("#file-says", "the machine runs")
    assert (flash_of(editor) / "custom.py").read_text() == good
    editor.sees("Idle")
    # The machine reports a failed handler; the page must find the line in its text.
    editor.bridge.machine.machine.say(b"[MSG:M100: custom.py, line 5, in f: divide by zero]\r\n")
    editor.reads("#file-says", "Line 5: M100: custom.py, line 5")
    editor.reads("#file-fault", "divide by zero")
    assert editor.text("#file-numbers .bad").strip() == "5"
    number = editor.page.locator("#file-numbers .bad").bounding_box()
    message = editor.page.locator("#file-fault").bounding_box()
    assert abs(number["y"] - message["y"]) < 5, "beside the line"
    assert editor.page.evaluate(_MARKED) == "    1 / 0"
    editor.page.locator("#board-text").press("End")
    editor.page.keyboard.type(" ")
    assert not editor.page.is_visible("#file-fault"), "the text is another now"
    assert (flash_of(editor) / "board.py").read_text() == _PICO


# The boot loader's drive

_DRIVE = """
async ([id, name, bytes]) => {
  const root = await navigator.storage.getDirectory(), create = { create: true };
  const drive = await root.getDirectoryHandle(id || "none", create);
  if (id) {
    const info = await (await drive.getFileHandle("INFO_UF2.TXT", create)).createWritable();
    await info.write(`UF2 Bootloader v3.0\\nModel: Raspberry Pi\\nBoard-ID: ${id}\\n`);
    await info.close();
  }
  try {
    const words = await writeToDrive(new File([new Uint8Array(bytes)], name), drive);
    return [words, (await (await drive.getFileHandle(name)).getFile()).size];
  } catch (error) { return [error.message, 0]; }
}
"""


def uf2(family: int) -> bytes:
    """Return one 512-byte block of a UF2 file for a chip family."""
    # Two magic numbers, flags, address, data bytes, block number, blocks, chip family.
    words = (0x0A324655, 0x9E5D5157, 0x2000, 0x10000000, 256, 0, 1, family)
    return (
        b"".join(word.to_bytes(4, "little") for word in words) + bytes(476) + b"\x30\x6f\xb1\x0a"
    )


@pytest.mark.parametrize(
    ("drive", "image", "words"),
    [
        # 0xE48BFF56 is RP2040, 0xE48BFF59 RP2350, 0xADA52840 nRF52840.
        ("RPI-RP2", uf2(0xE48BFF56), "f.uf2 is on the board"),
        ("RPI-RP2", uf2(0xE48BFF59), "for an RP2350, and the board has an RP2040"),
        ("RP2350", uf2(0xE48BFF59), "f.uf2 is on the board"),
        ("", uf2(0xE48BFF56), "not the drive of a board"),
        ("RPI-RP2", b"no image" * 100, "This is no UF2 file"),
        ("RPI-RP2", uf2(0xADA52840), "for another chip"),
    ],
)
def test_only_matching_file_is_written_to_drive(person_at, drive, image, words):
    """A UF2 file is written only if its chip family fits the boot loader's drive.

    drive: Board-ID in INFO_UF2.TXT; "": a drive without that file.
    """
    person = person_at()
    person.open_served()  # the browser's private folder needs a page with an address
    message, written_bytes = person.page.evaluate(_DRIVE, [drive, "f.uf2", list(image)])
    assert words in message
    assert written_bytes == (len(image) if "is on the board" in words else 0)
