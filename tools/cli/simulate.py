"""`ugrbl sim`: the firmware on a pseudo-terminal, on TCP, or on stdin and stdout."""

import signal
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from rich.console import Console

from .. import paths
from ..boardfile import page_files
from ..boardfile.engines import WIRELESS
from ..boardfile.files import load_board
from ..draw import plot
from ..draw.job import job_of
from ..draw.motion_trace import MotionTrace
from ..grbl.gcode_file import STDIN
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


_HOST = "ugrbl"  # name of the simulated board


@dataclass
class Options:
    """The options of the command line."""

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
    page: str | None = None
    around: machine.Around = machine.NOTHING


def simulate(options: Options) -> None:
    """Run until a signal comes, or until stdin has ended and all its lines are processed."""
    wire = _wire(options)
    network = _network(options)
    try:
        rig = machine.build(
            options.board,
            lambda rig: _link(rig, LiveLink(rig, wire, options.fast), network),
            options.settings,
            blank=options.blank,
            around=options.around,
            keeps_jobs=True,
        )
        if options.switches:
            from ..sim import switches

            switches.fit(rig)
        recorder = (MotionTrace if options.plot else Recorder)(rig)
        _stop_on_signals(rig.link)
        _publish(wire, options.link)
        if network:
            _say(f"and on TCP at {network.calls.host}:{network.calls.port}")
            if network.page:
                _say(f"and its page is at http://{network.page.host}:{network.page.port}/")
        if not options.stdio:
            _listen_to_user(rig)
        machine.run(rig)
    finally:
        wire.close()
        if network:
            network.close()
    if options.report:
        save_json(asdict(recorder.totals()), options.report)
    if options.plot and isinstance(recorder, MotionTrace):
        _draw(options, rig, recorder)


def _draw(options: Options, rig: "Rig", trace: MotionTrace) -> None:
    """Draw what the motors did, with the settings at the end. The title is the picture's name, or
    on stdout the board's."""
    settings = [f"${number}={value}" for number, value, _ in rig.controller.settings.each()]
    result = Result(totals=trace.totals())
    job = job_of("as run", (), settings, options.board, result, trace)  # (): no program
    file = cast(Path, options.plot)
    title = options.board if str(file) == STDIN else file.stem
    plot.save([job], title, words="", file=file)


def _wire(options: Options) -> "Pty | Tcp | Stdio":
    """Return the wire to the sender. ValueError if options contradict each other."""
    if sum((options.link is not None, options.tcp is not None, options.stdio)) > 1:
        raise ValueError("use only one of --port, --tcp and --stdio")
    if options.tcp is not None:
        from ..run.tcp_link import Rfc2217, Tcp, address

        return (Rfc2217 if options.rfc2217 else Tcp)(*address(options.tcp))
    if options.rfc2217:
        raise ValueError("--rfc2217 needs --tcp")
    try:
        from ..run.pty_link import Pty, Stdio
    except ImportError as error:
        raise ValueError("this system has no pseudo-terminals: use --tcp PORT") from error
    return Stdio() if options.stdio else Pty()


def _publish(wire: "Pty | Tcp | Stdio", link: Path | None) -> None:
    """Show where the simulated Grbl is, and make the link to it that --port names."""
    name = getattr(wire, "name", "")
    if link:
        wire.link(link)  # type: ignore[union-attr]  # a Pty, see _wire()
    if name:
        _say(f"Grbl is at {link or name}")


def _say(text: str) -> None:
    Console().print(text, highlight=False, soft_wrap=True)


class Network(NamedTuple):
    """The ports that a simulated network listens on. calls: the port for Grbl. page: the port for
    HTTP, and folder: the page's files, if the board serves the page."""

    calls: "HostCalls"
    page: "HostCalls | None" = None
    folder: "TemporaryDirectory[str] | None" = None

    def close(self) -> None:
        """Stop listening."""
        self.calls.close()
        if self.page and self.folder:
            self.page.close()
            self.folder.cleanup()


def _network(options: Options) -> Network | None:
    """Return the network of a board that has one; None without --network. ValueError if the board
    has none."""
    if options.network is None:
        if options.page is not None:
            raise ValueError("--page is for a board with a network: add --network PORT")
        return None
    board = load_board(options.board)
    if getattr(board, "LINK", "") not in WIRELESS.values():
        raise ValueError(f"{options.board} has no network; --board sim_wifi has one")
    if options.page is not None and not getattr(board, "PAGE", False):
        raise ValueError(f"{options.board} serves no page; --board sim_page does")
    calls = _listen(options.network)
    if options.page is None:
        return Network(calls)
    try:
        return Network(calls, _listen(options.page), TemporaryDirectory(prefix="ugrbl-"))
    except BaseException:  # the port for the page is in use
        calls.close()
        raise


def _listen(place: str) -> "HostCalls":
    from ..run.tcp_link import HostCalls, address

    return HostCalls(*address(place))


def _link(rig: "Rig", cable: LiveLink, network: Network | None) -> Any:
    """Return the cable; with a network the firmware's own link for boards with one, around the
    cable."""
    if network is None:
        return cable
    paths.use_firmware()
    complete()  # MicroPython's functions of `time`, which the link needs
    from ports.net.page import Page

    from ..sim.network import RigLink, RigPageLink

    if network.page is None or network.folder is None:
        return RigLink(rig, cable, network.calls)
    page_files.save(Path(network.folder.name))
    page = Page(network.calls, network.page, _HOST, network.folder.name + "/")
    return RigPageLink(rig, cable, page, _HOST)


def _listen_to_user(rig: "Rig") -> None:
    """Let a user at the terminal push inputs, by lines on stdin; with custom.py also through a
    pipe."""
    if sys.stdin is None or not (sys.stdin.isatty() or rig.custom_module):
        return
    buttons = Buttons(rig.inputs, Console())
    rig.link.turn = buttons.poll  # called whenever the firmware reads
    if rig.custom_module:
        rig.custom_module.on_person_wait = buttons.say
        rig.custom_module.on_switched = lambda name, on: buttons.say(
            f"{name} {'on' if on else 'off'}"
        )
    buttons.listen()


def _stop_on_signals(link: LiveLink) -> None:
    """Make the first signal end the simulation between two events, and a second one at once."""

    def stop(number: int, frame: FrameType | None) -> None:
        if link.stopping:
            raise KeyboardInterrupt
        link.stopping = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
