"""The command line `ugrbl`: its commands and options. Other modules do the work."""

import os
import sys
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from typer.core import TyperGroup

from .. import __version__, paths
from ..run.machine import DEFAULT_BOARD
from . import (
    build,
    conformance,
    console,
    custom_board,
    deploy,
    doctor,
    job,
    new_board,
    plot,
    ports,
    run,
    selftest,
    send,
    settings,
    uf2,
    web,
    wifi,
)
from .custom_options import CustomFile, Inputs, around
from .outputs import check_outputs, failed


class _Commands(TyperGroup):
    """Shows that Ctrl-C ended a command, because the progress bar alone looks as at the end. The
    exit code is then 130."""

    def invoke(self, ctx: typer.Context) -> object:  # type: ignore[override]
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            Console(stderr=True).print("[red]stopped by Ctrl-C, before its end")
            raise


# Without markup, help is wrapped to the terminal, and text in brackets is kept.
app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,
)
app.command("build", epilog=build.EXAMPLES)(build.command)
app.command("conformance")(conformance.command)
app.command("console", epilog=console.EXAMPLES)(console.command)
app.command("deploy", epilog=deploy.EXAMPLES)(deploy.command)
app.command("doctor", epilog=doctor.EXAMPLES)(doctor.command)
app.command("new-board", epilog=new_board.EXAMPLES)(new_board.command)
app.command("plot", epilog=plot.EXAMPLES)(plot.command)
app.command("run", epilog=run.EXAMPLES)(run.command)
app.command("ports")(ports.command)
app.command("send", epilog=send.EXAMPLES)(send.command)
app.command("uf2", epilog=uf2.EXAMPLES)(uf2.command)
app.command("web", epilog=web.EXAMPLES)(web.command)
app.command("wifi", epilog=wifi.EXAMPLES)(wifi.command)
app.command("selftest", epilog=selftest.EXAMPLES)(selftest.command)
app.add_typer(custom_board.app, name="custom")
app.add_typer(job.app, name="job")
app.add_typer(settings.app, name="settings")


def _show_version(wanted: bool) -> None:
    """Print the versions and end the command, if --version is given."""
    if not wanted:
        return
    paths.use_firmware()
    from talk import report

    print(f"ugrbl {__version__}, firmware {report.BUILD}: Grbl {report.VERSION}")
    raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_show_version,
            is_eager=True,
            help="Show the version, and the version of Grbl it follows.",
        ),
    ] = False,
) -> None:
    """Grbl for microcontrollers in MicroPython: simulate, send, look, set up."""


class Speed(str, Enum):
    """Speed of the simulator's clock."""

    REAL = "real"
    MAX = "max"


Board = Annotated[str, typer.Option(metavar="NAME", help="Machine: a file of boards/.")]

Blank = Annotated[
    bool, typer.Option("--blank", help="Start with erased memory, as before the first start.")
]
Switches = Annotated[
    bool,
    typer.Option("--switches", help="Simulate limit switches at both ends of travel ($130-$132)."),
]
Network = Annotated[
    str | None,
    typer.Option(
        metavar="[HOST:]PORT", help="Also listen on TCP, as a networked board: docs/network.md."
    ),
]
Page = Annotated[
    str | None,
    typer.Option(
        metavar="[HOST:]PORT", help="With --network: also serve the control page, at this port."
    ),
]
TcpPlace = Annotated[
    str | None,
    typer.Option(
        metavar="[HOST:]PORT", help="Listen on TCP instead; without HOST: this computer only."
    ),
]
KeptSettings = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="File for settings, in the form of `ugrbl settings pull`."),
]


@app.command()
def sim(
    board: Board = DEFAULT_BOARD,
    port: Annotated[
        Path | None, typer.Option(metavar="LINK", help="Create this link to the pseudo-terminal.")
    ] = None,
    tcp: TcpPlace = None,
    rfc2217: Annotated[
        bool,
        typer.Option("--rfc2217", help="With --tcp: act as a serial port for rfc2217:// URLs."),
    ] = False,
    stdio: Annotated[
        bool, typer.Option("--stdio", help="Use stdin and stdout instead of a pseudo-terminal.")
    ] = False,
    speed: Annotated[
        Speed, typer.Option(help="real: as fast as a machine; max: as fast as possible.")
    ] = Speed.REAL,
    settings: KeptSettings = None,
    blank: Blank = False,
    switches: Switches = False,
    report: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="At the end, write steps and times to this file."),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="At the end, draw the tool's path to this file."),
    ] = None,
    network: Network = None,
    page: Page = None,
    custom_file: CustomFile = None,
    inputs: Inputs = None,
) -> None:
    """Run the firmware in a simulator that any sender can open.

    It is on a pseudo-terminal, or on TCP. Type an input's name there to push it: probe, limit_x …
    """
    from .simulate import Options, simulate

    try:
        check_outputs(report, plot=plot, given=locals())
        options = Options(
            board=board,
            link=port,
            stdio=stdio,
            fast=speed is Speed.MAX,
            settings=settings,
            report=report,
            plot=plot,
            switches=switches,
            tcp=tcp,
            rfc2217=rfc2217,
            blank=blank,
            network=network,
            page=page,
            around=around(board, custom_file, inputs),
        )
        simulate(options)
    except (ValueError, OSError) as error:
        raise failed(error) from error


@app.command()
def demo() -> None:
    """Stream an example into the simulator; draw what the motors did."""
    from ..device.connection import SendError
    from .demo import demo as show

    try:
        good = show(Console())
    except SendError as error:
        raise failed(error) from error
    if not good:
        raise typer.Exit(1)


def ugrbl() -> None:
    """Run the command line. If the reader of its output ends early (`| head`), it ends without a
    message."""
    try:
        app()
    finally:
        try:
            sys.stdout.flush()
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
