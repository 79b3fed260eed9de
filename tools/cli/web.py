"""The command `ugrbl web`."""

import asyncio
import ipaddress
import signal
import socket
import threading
import webbrowser
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer

from .. import paths
from ..boardfile import page_files
from ..boardfile.files import load_board
from ..device.connection import BAUD, SendError
from ..run import machine
from .outputs import examples, failed
from .ports import Baud, Port, choose

EXAMPLES = examples(
    "ugrbl web",
    "ugrbl web --port /dev/ttyACM0",
    "ugrbl web --sim",
    "ugrbl web --host 0.0.0.0 --no-browser",
    "ugrbl web --save ugrbl.html",
)


@dataclass
class Options:
    """The options of the command line."""

    port: str | None
    baud: int
    sim: bool
    board: str
    settings: Path | None
    host: str
    http: int
    browser: bool


def command(
    port: Port = None,
    baud: Baud = BAUD,
    sim: Annotated[
        bool,
        typer.Option("--sim", help="Use the simulator, with limit switches, instead of a board."),
    ] = False,
    board: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="Machine for --sim and for previews: a file of boards/."
        ),
    ] = machine.DEFAULT_BOARD,
    settings: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="With --sim: settings file, as `ugrbl settings pull` writes it."
        ),
    ] = None,
    host: Annotated[
        str, typer.Option(metavar="HOST", help="Address to listen at; 0.0.0.0: the whole network.")
    ] = "127.0.0.1",
    http: Annotated[
        int,
        typer.Option(
            metavar="PORT", min=0, max=65535, help="TCP port to listen at; 0: any free one."
        ),
    ] = 8010,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")
    ] = True,
    save: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the page to this file, and start no server."),
    ] = None,
) -> None:
    """Serve a page that jogs the machine and sends jobs.

    Any number of browsers may watch; one controls the machine. On the network, anyone with the
    printed address and its token can move the machine. Ctrl-C ends it; a moving machine is held.
    """
    try:
        if save:
            paths.write(save, page_files.page().encode())
            print(f"written: {save}; open it in Chrome or Edge")
            return
        options = Options(
            port=port,
            baud=baud,
            sim=sim,
            board=board,
            settings=settings,
            host=host,
            http=http,
            browser=browser,
        )
        _check(options)
        asyncio.run(_serve(options))
    except (SendError, ValueError, OSError) as error:
        raise failed(error) from error


def _check(options: Options) -> None:
    """Check the options before anything is opened. Raises ValueError or SendError."""
    if options.sim and options.port:
        raise ValueError("use only one of --port and --sim")
    if options.settings and not options.sim:
        raise ValueError("--settings is for --sim: a board keeps its own")
    load_board(options.board)
    if not options.sim:
        try:
            choose(options.port)
        except SendError as error:
            raise SendError(f"{error}; --sim simulates one") from error


async def _serve(options: Options) -> None:
    """Serve until a signal arrives."""
    from ..web.access import Access
    from ..web.board_link import SerialSource, Source
    from ..web.server import Server
    from ..web.simulator import Simulator

    source: Source = SerialSource(lambda: choose(options.port), options.baud)
    if options.sim:
        source = Simulator(options.board, options.settings)

    def log(text: str) -> None:
        with suppress(OSError):  # the terminal may be closed; the machine must still be held
            print(text, flush=True)

    access = Access(options.host)
    server = Server(source, access, options.board, log)
    ended = _on_signals()
    try:
        port = await server.start(options.host, options.http)
        address = _address(options.host, port, access.token)
        log(f"{source.name} is at {address}")
        if options.browser:
            # In a thread, because some browsers return only when they end.
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
        await ended.wait()
    finally:
        await server.stop()


def _on_signals() -> asyncio.Event:
    """Return an event that the first signal sets; a second signal ends the process at once."""
    loop, ended = asyncio.get_running_loop(), asyncio.Event()

    def end(number: int, frame: FrameType | None) -> None:
        signal.signal(number, signal.default_int_handler)
        loop.call_soon_threadsafe(ended.set)

    for number in (signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGINT)):
        if signal.getsignal(number) is not signal.SIG_IGN:  # ignored by nohup
            signal.signal(number, end)
    return ended


def _address(host: str, port: int, token: str) -> str:
    """Return the address to open in a browser. host: as given to --host."""
    name = host.strip("[]")  # an IPv6 address may be in brackets
    try:
        if ipaddress.ip_address(name).is_unspecified:  # 0.0.0.0: every network
            name = _own_address()
    except ValueError:
        return _url(name, port, token)  # a host name
    return _url(f"[{name}]" if ":" in name else name, port, token)


def _url(name: str, port: int, token: str) -> str:
    return f"http://{name}:{port}/" + (f"?token={token}" if token else "")


def _own_address() -> str:
    """Return this computer's address on the network."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing, only selects a route
        except OSError:
            return socket.gethostname()  # no network
        return str(probe.getsockname()[0])
