"""`ugrbl sim`: the firmware behind a pseudo-terminal, or on stdin and stdout."""

import signal
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from rich.console import Console

from . import machine, picture
from .live import LiveLink
from .pty_link import Pty, Stdio
from .recorder import Recorder


@dataclass
class Options:
    """What the command line asks for."""

    board: str = machine.DEFAULT_BOARD
    link: Path | None = None
    stdio: bool = False
    fast: bool = False
    settings: Path | None = None
    report: Path | None = None
    plot: Path | None = None
    switches: bool = False


def simulate(options: Options) -> None:
    """Run until a signal comes, or until stdin ends and all it asked for is done."""
    wire = Stdio() if options.stdio else Pty()
    try:
        rig = machine.build(
            options.board, lambda rig: LiveLink(rig, wire, options.fast), options.settings
        )
        if options.switches:
            from .sim import switches

            switches.fit(rig)
        recorder = Recorder(rig, keep_path=options.plot is not None)
        _stop_on_signals(rig.link)
        if isinstance(wire, Pty):
            _publish(wire, options.link)
        machine.run(rig)
    finally:
        wire.close()
    if options.plot:
        picture.save(picture.strokes(recorder.path), options.plot, marks=recorder.marks)
    if options.report:
        recorder.totals().save(options.report)


def _publish(wire: Pty, link: Path | None) -> None:
    if link:
        wire.link(link)
    Console().print(f"Grbl is at {link or wire.name}", highlight=False, soft_wrap=True)


def _stop_on_signals(link: LiveLink) -> None:
    """The first signal ends the simulation between two events; a second one, at once."""

    def stop(number: int, frame: FrameType | None) -> None:
        if link.stopping:
            raise KeyboardInterrupt
        link.stopping = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
