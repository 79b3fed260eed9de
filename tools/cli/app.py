"""The command line `ugrbl`: what there is to type. The work is done elsewhere."""

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from ..replay.conformance import conformance
from ..run.machine import DEFAULT_BOARD
from . import build as build_cli
from . import console as console_cli
from . import decode as decode_cli
from . import deploy as deploy_cli
from . import doctor, ports
from . import new_board as new_board_cli
from . import plot as plot_cli
from . import run as run_cli
from . import selftest as selftest_cli
from . import send as send_cli
from . import settings as settings_cli
from .outputs import check_outputs

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False, add_completion=False)
app.command("build", epilog=build_cli.EXAMPLES)(build_cli.command)
app.command()(conformance)
app.command("console", epilog=console_cli.EXAMPLES)(console_cli.command)
app.command("decode", epilog=decode_cli.EXAMPLES)(decode_cli.command)
app.command("deploy", epilog=deploy_cli.EXAMPLES)(deploy_cli.command)
app.command("doctor", epilog=doctor.EXAMPLES)(doctor.command)
app.command("new-board", epilog=new_board_cli.EXAMPLES)(new_board_cli.command)
app.command("plot", epilog=plot_cli.EXAMPLES)(plot_cli.command)
app.command("run", epilog=run_cli.EXAMPLES)(run_cli.command)
app.command("ports")(ports.command)
app.command("send", epilog=send_cli.EXAMPLES)(send_cli.command)
app.command("selftest", epilog=selftest_cli.EXAMPLES)(selftest_cli.command)
app.add_typer(settings_cli.app, name="settings")


class Speed(str, Enum):
    """How fast the simulator's clock runs."""

    REAL = "real"
    MAX = "max"


Board = Annotated[str, typer.Option(metavar="NAME", help="Machine: a file of boards/.")]


@app.command()
def sim(
    board: Board = DEFAULT_BOARD,
    port: Annotated[
        Path | None, typer.Option(metavar="LINK", help="Link to the pseudo-terminal, made there.")
    ] = None,
    tcp: Annotated[
        str | None,
        typer.Option(metavar="[HOST:]PORT", help="On TCP instead; no HOST: this computer only."),
    ] = None,
    rfc2217: Annotated[
        bool, typer.Option("--rfc2217", help="With --tcp: as a serial port, for rfc2217:// URLs.")
    ] = False,
    stdio: Annotated[bool, typer.Option("--stdio", help="On stdin and stdout instead.")] = False,
    speed: Annotated[
        Speed, typer.Option(help="max: motion takes no longer than computing it.")
    ] = Speed.REAL,
    settings: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Keeps them between runs, as `ugrbl settings pull`."),
    ] = None,
    blank: Annotated[
        bool, typer.Option("--blank", help="With an erased memory, as before the first start.")
    ] = False,
    switches: Annotated[
        bool, typer.Option("--switches", help="Limit switches at both ends of $130-$132, for $H.")
    ] = False,
    report: Annotated[
        Path | None, typer.Option(metavar="FILE", help="At the end, write steps and times there.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="At the end, draw the tool's path there.")
    ] = None,
) -> None:
    """Run the firmware behind a pseudo-terminal, or on TCP, that any sender can open."""
    from .simulate import Options, simulate

    try:
        check_outputs(report, plot=plot, keep=(settings,))
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
        )
        simulate(options)
    except (ValueError, OSError) as error:
        raise _failed(error) from error


@app.command()
def demo() -> None:
    """Stream an example into the simulator and draw what the motors did."""
    from ..device.connection import SendError
    from .demo import demo as show

    try:
        good = show(Console())
    except SendError as error:
        raise _failed(error) from error
    if not good:
        raise typer.Exit(1)


def _failed(why: object) -> typer.Exit:
    """Say why on stderr; raise what this returns."""
    Console(stderr=True).print(f"[red]{escape(str(why))}", highlight=False)
    return typer.Exit(1)


if __name__ == "__main__":
    app()
