"""`ugrbl sim`: the firmware behind a pseudo-terminal, on TCP, or on stdin and stdout."""

import signal
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, cast

from rich.console import Console

from .. import paths
from ..boardfile.files import load_board
from ..draw import plot
from ..draw.job import job_of
from ..draw.motion_trace import MotionTrace
from ..run import machine
from ..run.board_modules import complete
from ..run.live import LiveLink
from ..run.program import Result
from ..run.recorder import Recorder
from .buttons import Buttons
from .outputs import save_json

if TYPE_CHECKING:
    from ..run.pty_link import Pty, Stdio
    from ..run.tcp_link import HostCalls, Tcp
    from ..sim.rig import Rig


# Links that have one.
_NETWORKS = ("wifi", "uart_wifi")


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
    tcp: str | None = None
    rfc2217: bool = False
    blank: bool = False
    network: str | None = None
    around: machine.Around = machine.NOTHING


def simulate(options: Options) -> None:
    """Run until a signal comes, or until stdin ends and all it asked for is done."""
    wire = _wire(options)
    calls = _calls(options)
    try:
        rig = machine.build(
            options.board,
            lambda rig: _link(rig, LiveLink(rig, wire, options.fast), calls),
            options.settings,
            blank=options.blank,
            around=options.around,
        )
        if options.switches:
            from ..sim import switches

            switches.fit(rig)
        recorder = (MotionTrace if options.plot else Recorder)(rig)
        _stop_on_signals(rig.link)
        _publish(wire, options.link)
        if calls:
            _say(f"and on TCP at {calls.host}:{calls.port}")
        if not options.stdio:
            _hear_person(rig)
        machine.run(rig)
    finally:
        wire.close()
        if calls:
            calls.close()
    if options.report:
        save_json(asdict(recorder.totals()), options.report)
    if options.plot and isinstance(recorder, MotionTrace):
        _draw(options, rig, recorder)


def _draw(options: Options, rig: "Rig", trace: MotionTrace) -> None:
    """What the motors did, with the settings of the end."""
    settings = [f"${number}={value}" for number, value, _ in rig.controller.settings.each()]
    result = Result(totals=trace.totals())
    job = job_of("as run", (), settings, options.board, result, trace)
    plot.save([job], options.board, "", cast(Path, options.plot))


def _wire(options: Options) -> "Pty | Tcp | Stdio":
    """What the sender will be on. ValueError where that is said twice."""
    if sum((options.link is not None, options.tcp is not None, options.stdio)) > 1:
        raise ValueError("say one of --port, --tcp and --stdio")
    if options.tcp is not None:
        from ..run.tcp_link import Rfc2217, Tcp, address

        return (Rfc2217 if options.rfc2217 else Tcp)(*address(options.tcp))
    if options.rfc2217:
        raise ValueError("--rfc2217 is for --tcp")
    try:
        from ..run.pty_link import Pty, Stdio
    except ImportError as error:
        raise ValueError("there are no pseudo-terminals here: use --tcp PORT") from error
    return Stdio() if options.stdio else Pty()


def _publish(wire: "Pty | Tcp | Stdio", link: Path | None) -> None:
    name = getattr(wire, "name", "")
    if link:
        wire.link(link)  # type: ignore[union-attr]  # a Pty, see _wire()
    if name:
        _say(f"Grbl is at {link or name}")


def _say(text: str) -> None:
    Console().print(text, highlight=False, soft_wrap=True)


def _calls(options: Options) -> "HostCalls | None":
    """Who calls over the network of a board that has one. ValueError where it has none."""
    if options.network is None:
        return None
    from ..run.tcp_link import HostCalls, address

    host, port = address(options.network)
    if getattr(load_board(options.board), "LINK", "") not in _NETWORKS:
        raise ValueError(f"{options.board} has no network; --board sim_wifi has one")
    return HostCalls(host, port)


def _link(rig: "Rig", cable: LiveLink, calls: "HostCalls | None") -> Any:
    """The cable's, or the firmware's own around it."""
    if calls is None:
        return cable
    paths.use_firmware()
    complete()
    from ..sim.network import RigLink

    return RigLink(rig, cable, calls)


def _hear_person(rig: "Rig") -> None:
    """Whoever sits at the terminal can push inputs; with custom.py a pipe can, too."""
    if sys.stdin is None or not (sys.stdin.isatty() or rig.guest):
        return
    buttons = Buttons(rig.inputs, Console())
    rig.link.turn = buttons.turn
    if rig.guest:
        rig.guest.told = buttons.say
        rig.guest.switched = lambda name, on: buttons.say(f"{name} {'on' if on else 'off'}")
    buttons.listen()


def _stop_on_signals(link: LiveLink) -> None:
    """The first signal ends the simulation between two events; a second one, at once."""

    def stop(number: int, frame: FrameType | None) -> None:
        if link.stopping:
            raise KeyboardInterrupt
        link.stopping = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
