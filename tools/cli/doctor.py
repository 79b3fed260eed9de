"""The command `ugrbl doctor`."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from ..device import board_under_test, checkup, settings_check
from ..device import settings_sync as sync
from ..device.checkup import BAD, NOTE, OK, Finding
from ..device.connection import BAUD, Connection, SendError, way_out
from ..grbl.settings_file import AXES, Firmware, Settings
from ..paths import use_firmware
from . import ports
from .outputs import check_output, examples, save_json
from .ports import Baud, Port

EXAMPLES = examples(
    "ugrbl doctor",
    "ugrbl doctor --port /dev/ttyACM0 --pins 20 --move",
    "ugrbl doctor --port COM3 --no-move --json -",
)
_MARKS = {OK: "[green]ok  [/]", NOTE: "[yellow]note[/]", BAD: "[red]BAD [/]"}
_PINS_S = 15.0  # how long inputs are watched by default
_TEST_RATE = 200.0  # mm/min
# The first numbers of settings that each axis has.
_FIRST_STEPS_PER_MM = 100  # $100 for X, $101 for Y
_FIRST_MAX_RATE = 110  # $110 for X, $111 for Y


class Doctor:
    """One examination: every finding is shown at once, and stored."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self.findings: list[Finding] = []

    def add(self, *findings: Finding) -> None:
        """Show and store findings."""
        for finding in findings:
            self.findings.append(finding)
            mark = _MARKS[finding.verdict]
            self.console.print(
                f"{mark} [b]{finding.what}[/b]: {escape(finding.text)}", highlight=False
            )
            if finding.todo:
                self.console.print(f"       -> {escape(finding.todo)}", highlight=False)

    def see(
        self, port: str, baud: int, pins_s: float | None, may_move: Callable[[], bool], ask: bool
    ) -> None:
        """Examine what is on a port. pins_s, ask: see _examine(). may_move: returns whether the
        machine may move; it may ask the user."""
        with self.console.status(f"listening on {port} …"):
            connection = Connection(port, baud)
            alive = connection.answers()
        if not alive:
            connection.close()
            self.add(*board_under_test.stranger(port, baud))
            return
        try:
            self.add(Finding("port", OK, f"a Grbl answers on {port}"))
            state = connection.state()
            fault = board_under_test.fault(connection) if state == "Alarm" else ""
            if fault:
                self.add(checkup.fault(fault))
            elif state in sync.QUIET:  # it answers queries
                self._examine(connection, pins_s, may_move, ask)
            else:
                text = f"{state}: Grbl answers no queries in this state"
                todo = f"{way_out(state)}; then run this again"
                self.add(Finding("state", BAD, text, todo))
                self.add(*checkup.pins_at_rest(board_under_test.pins(connection), values={}))
        finally:
            connection.close()

    def _examine(
        self,
        connection: Connection,
        pins_s: float | None,
        may_move: Callable[[], bool],
        ask: bool,
    ) -> None:
        """Examine a Grbl that answers: firmware, settings, inputs, and a small move of each axis.

        pins_s: how long to watch the inputs; 0: not at all; None: _PINS_S, if `ask` and the user
        agrees. ask: there is a user.
        """
        settings = sync.pull(connection)
        self.add(checkup.firmware(settings.firmware, _our_build()))
        self.add(*checkup.link(settings.firmware))
        health = _health(connection, settings.firmware)
        self.add(*checkup.frozen(health))
        self.add(*checkup.stack(health), *checkup.drains(health), *checkup.faults(health))
        self.add(*checkup.custom(health))
        self._state(connection)
        values = _numbers(settings)
        self.add(*settings_check.settings(values, settings.firmware))
        board_under_test.report(connection)  # the inputs of the next line are from this report
        self.add(*checkup.pins_at_rest(board_under_test.pins(connection), values))
        axes = sum(_FIRST_STEPS_PER_MM + axis in values for axis in range(len(AXES)))
        if pins_s is None and ask and typer.confirm("Watch the inputs while you press them?"):
            pins_s = _PINS_S
        if pins_s:
            self.console.print(f"press each switch now; {pins_s:g} s …", highlight=False)
            pressed = board_under_test.watch_pins(connection, pins_s, self._pin)
            self.add(*checkup.pins_pressed(pressed, values, axes))
        if may_move():
            for axis in range(axes):
                rate = min(_TEST_RATE, values.get(_FIRST_MAX_RATE + axis, _TEST_RATE))
                self.add(board_under_test.move(connection, axis, AXES[axis], rate))
                if self.findings[-1].verdict != OK:
                    break

    def _state(self, connection: Connection) -> None:
        """Add a finding about the machine's state: any but Idle is worth a look."""
        state = connection.state()
        if state == "Idle":
            self.add(Finding("state", OK, "Idle"))
        else:
            self.add(Finding("state", NOTE, state, f"{way_out(state)}; then run this again"))

    def _pin(self, name: str, is_on: bool) -> None:
        self.console.print(f"     {name}: {'on' if is_on else 'off'}", highlight=False)

    def verdict(self) -> str:
        """Return a summary in one sentence."""
        bad = sum(finding.verdict == BAD for finding in self.findings)
        notes = sum(finding.verdict == NOTE for finding in self.findings)
        if not bad and not notes:
            return "all is well"
        wrong, worth_a_look = (
            f"{bad} wrong" if bad else "",
            f"{notes} worth a look" if notes else "",
        )
        return ", ".join(filter(None, (wrong, worth_a_look)))


def _health(connection: Connection, found: Firmware) -> list[str]:
    """Return the reply of our firmware to `$I+`; a firmware without it refuses it, and other
    firmwares are not asked."""
    return connection.ask("$I+") if checkup.is_ours(found) else []


def _our_build() -> str:
    """Return the build of the firmware in this package."""
    use_firmware()
    from talk import report

    return report.BUILD


def _numbers(settings: Settings) -> dict[int, float]:
    """Return the values of settings as numbers, by setting."""
    return {number: float(value) for number, value in settings.values.items()}


def _find(doctor: Doctor, port: str | None) -> str:
    """Return the port to examine, and show all ports with a controller."""
    for controller in ports.find():
        doctor.add(Finding("usb", OK, f"{controller.port}: {controller.what}"))
    return ports.choose(port)


def command(
    port: Port = None,
    baud: Baud = BAUD,
    pins: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            min=0,
            help="How long to watch the inputs; 0: not at all. [default: ask]",
        ),
    ] = None,
    move: Annotated[
        bool | None,
        typer.Option("--move/--no-move", help="Move each axis a millimetre. [default: ask]"),
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option(
            "--json", metavar="FILE", help="Write the findings to this file; - is stdout."
        ),
    ] = None,
) -> None:
    """Find the faults of a machine, and say what to do.

    Looks for the port, the board and the firmware; checks the version, the settings against the
    machine's limits, the inputs as you press them, and a small move. The exit code is 1 if
    something is wrong.
    """
    ask = sys.stdin.isatty()
    check_output(json_file)
    doctor = Doctor(Console(stderr=str(json_file) == "-"))

    def may_move() -> bool:
        if move is None:
            return ask and typer.confirm("Move each axis a millimetre there and back?")
        return move

    try:
        doctor.see(_find(doctor, port), baud, pins, may_move, ask)
    except SendError as error:
        doctor.add(Finding("port", BAD, str(error)))
    _close(doctor, doctor.findings, json_file)


def _close(doctor: Doctor, findings: Sequence[Finding], json_file: Path | None) -> None:
    """Show the verdict and write the findings. The exit code is 1 if something is wrong."""
    doctor.console.print(f"[b]{doctor.verdict()}[/b]", highlight=False)
    if json_file:
        rows = [finding.as_json() for finding in findings]
        save_json({"findings": rows, "verdict": doctor.verdict()}, json_file)
    if any(finding.verdict == BAD for finding in findings):
        raise typer.Exit(1)
