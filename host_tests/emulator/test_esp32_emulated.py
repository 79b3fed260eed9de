"""Test the deployed firmware in MicroPython on an ESP32 in QEMU (see qemu_esp32.py)."""

import json
import os
import re
from itertools import pairwise
from pathlib import Path

import pytest
from qemu_esp32 import IMAGE, Esp32, Step, lacks
from test_both_pythons import VECTORS, cpython
from test_deploy_emulated import deploy
from ugrbl.boardfile.files import load_board
from ugrbl.compiling import build
from ugrbl.compiling.inline import inline, pruned
from ugrbl.compiling.kernel_module import Apart
from ugrbl.paths import BOARDS

pytestmark = pytest.mark.xdist_group("esp32")

_BOARD = BOARDS / "esp32_devkit.py"
_ARCH = "xtensawin"
_CONVERSATIONS = Path(__file__).resolve().parents[3] / "shared" / "conformance"
_SOME = 20  # more conversations than this are played
_BLOCKS = 2  # of RMT's memory for each channel; a channel has the number of its first block


@pytest.fixture(scope="module")
def image() -> Path:
    """Return the MicroPython image for the chip, which must find its PSRAM."""
    if why := lacks():
        pytest.skip(why)
    return Path(os.environ[IMAGE])


@pytest.fixture(scope="module")
def files() -> "dict[str, bytes]":
    """Return the files that `ugrbl deploy` copies to it."""
    return build.for_board(_BOARD).files


@pytest.fixture(scope="module")
def machine(image: Path, files: "dict[str, bytes]") -> Esp32:
    return Esp32(image, files).power_on().boot()


def vectors_and_kernels() -> "dict[str, bytes]":
    """Return vectors.py and its imports, compiled for the chip."""
    texts = pruned(inline({**build.texts(), "vectors": VECTORS.read_text("utf-8")}))
    needed: dict[str, str] = {}
    to_visit = ["vectors"]
    while to_visit:
        name = to_visit.pop()
        if name in texts and name not in needed:
            needed[name] = texts[name]
            to_visit += build.imported(texts[name])
    compiled = build.compiled(_ARCH, Apart(texts=needed, c="", pieces={}))
    return {build.path_of(name): code for name, code in compiled.items()}


def signed_sums(steps: "list[Step]") -> "list[int]":
    """Return the sum of the steps of each axis, with their signs."""
    sums = [0, 0, 0]
    dir_pins = load_board("esp32_devkit").DIR
    for step in steps:
        axis = step.channel // _BLOCKS
        sums[axis] += -1 if step.levels >> dir_pins[axis] & 1 else 1
    return sums


def test_compiled_kernels_compute_the_integers_of_the_desktop(image: Path) -> None:
    """vectors.py prints the kernels' results for pseudo-random numbers. It runs at the prompt of a
    board that has only it and the modules it imports, and under CPython."""
    board = Esp32(image, vectors_and_kernels()).power_on()
    board.python("import sys, vectors", ">>> ")
    for part in ("reals", "words", "blocks", "arcs"):
        expected = cpython(part).splitlines()
        code = f"sys.argv[:] = ['', {part!r}]; vectors.main()"
        printed = board.python_again(code).splitlines()
        for number, (due, line) in enumerate(zip(expected, printed, strict=False)):
            assert due == line, f"line {number} of {part}"
        assert len(expected) == len(printed) > 300, board.output[-500:]


def test_empty_board_is_deployed_and_up_to_date(image: Path, files: "dict[str, bytes]") -> None:
    """The second deployment finds all files unchanged."""
    board = Esp32(image, {}).power_on()
    board.wait_for(">>> ")  # it reads nothing while it starts
    port = Path(board.port.port)
    code, done = deploy(port, _BOARD)
    assert code == 0, done
    assert sorted(done["copied"]) == sorted(files)
    assert done["banner"].startswith("Grbl 1.1h") and done["build"].startswith("1.1h.")
    assert done["micropython"].startswith("MicroPython 1.")
    code, again = deploy(port, _BOARD)
    assert (code, again["copied"], again["removed"]) == (0, [], [])
    assert again["unchanged"] == len(files)


def test_build_info_and_status_name_board_and_state(machine: Esp32) -> None:
    said = machine.ask("$I")
    assert "Grbl rmt 5000Hz" in said and "[OPT:V,63,128]" in said
    report = machine.status()
    assert (report["state"], report["MPos"]) == ("Idle", "0.000,0.000,0.000")


def test_setting_survives_a_power_cut(machine: Esp32) -> None:
    assert machine.ask("$100=300").endswith("ok\r\n")
    machine.power_off()
    machine.power_on().boot()
    assert "$100=300.000\r\n" in machine.ask("$$")
    machine.ask("$100=250")  # the default, for the other tests


def test_number_of_steps_is_exact_and_none_comes_early(machine: Esp32) -> None:
    """At 250 steps/mm. X and Y return to their start, Z ends at 0.5 mm."""
    before = len(machine.steps())
    for line in ("G91 G1 X4 F480", "G1 X-1 Y2 F400", "G1 X-3 Y-2 Z0.5 F300"):
        machine.ask(line)
    report = machine.wait_for_state("Idle")
    steps = machine.steps()[before:]
    assert report["MPos"] == "0.000,0.000,0.500"
    assert signed_sums(steps) == [0, 0, 125]
    counts = [sum(step.channel == _BLOCKS * axis for step in steps) for axis in range(3)]
    assert counts == [2000, 1000, 125]  # 8, 4 and 0.5 mm in either direction
    x_us = [step.us for step in steps if step.channel == 0]
    # F480 is 2000 steps/s, 500 us apart; docs/esp32.md has the deviation.
    assert min(b - a for a, b in pairwise(x_us)) > 500 - 60


def test_hold_loses_no_step_and_reset_in_motion_is_an_alarm(machine: Esp32) -> None:
    """A hold in a move of 3 mm, which is resumed; then a reset in the move back."""
    before = len(machine.steps())
    machine.ask("G91 G1 X3 F480")
    machine.wait_for_state("Run")
    machine.send("!")
    machine.wait_for_state("Hold:0")
    steps_until_hold = signed_sums(machine.steps()[before:])[0]
    assert 0 < steps_until_hold < 750
    machine.send("~")
    machine.wait_for_state("Idle")
    assert signed_sums(machine.steps()[before:])[0] == 750  # 3 mm at 250 steps/mm
    machine.ask("G1 X-3")
    machine.wait_for_state("Run")
    machine.clear_output()
    machine.send("\x18")
    assert "ALARM:3" in machine.wait_for("[MSG:'$H'|'$X' to unlock]")
    assert machine.wait_for_state("Alarm")
    machine.ask("$X")


@pytest.mark.parametrize("category", ["errors", "gcode_words"])
def test_lines_are_answered_as_by_real_grbl(machine: Esp32, category: str) -> None:
    """Play conversations recorded with real Grbl, only those that change nothing but modes: no
    motion, no settings, no offsets, no real-time bytes."""
    recorded = _CONVERSATIONS / f"{category}.json"
    if not recorded.is_file():
        pytest.skip(f"the recordings are not there: {recorded}")
    machine.ask("G90 G53 G0 X0 Y0 Z0")  # their start
    machine.wait_for_state("Idle")
    played = 0
    for case in json.loads(recorded.read_text("utf-8")):
        steps = case["steps"]
        if case["setup"] or any(step["wait"] not in ("ok", "idle") for step in steps):
            continue
        if any(any(step.get("moved", ())) for step in steps):
            continue
        if re.search(r"\$[^G]|G10|G28|G30|G38|G92", "".join(step["send"] for step in steps)):
            continue
        machine.clear_output()
        machine.send("\x18")
        machine.wait_for("for help]\r\n")
        for step in steps:
            machine.ask(step["send"].rstrip("\n"), f"{step['expect'][-1]}\r\n")
            assert machine.output.splitlines() == step["expect"], case["name"]
        machine.wait_for_state("Idle")
        played += 1
    assert played > _SOME


def test_memory_is_free_at_the_prompt(machine: Esp32) -> None:
    free_bytes = machine.python("import gc; gc.collect(); print(gc.mem_free())")
    assert int(free_bytes) > 3_000_000


def test_missing_psram_is_reported_with_the_remedy(image: Path, files: "dict[str, bytes]") -> None:
    board = Esp32(image, files, psram=False).power_on()
    assert "use a module with PSRAM" in board.wait_for("]\r\n")
