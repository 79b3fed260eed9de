"""`ugrbl wifi`: set up a board's network over its cable."""

from typing import Annotated

import typer
from rich.console import Console

from ..device import wifi
from ..device.connection import BAUD
from .outputs import examples, failed
from .ports import Baud, Port, connected

EXAMPLES = examples("ugrbl wifi", "ugrbl wifi --name Workshop", "ugrbl wifi --new-key")


def command(
    port: Port = None,
    baud: Baud = BAUD,
    name: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="The network to join; its password is asked for."),
    ] = None,
    open_: Annotated[bool, typer.Option("--open", help="The network has no password.")] = False,
    access_point: Annotated[
        bool,
        typer.Option(
            "--access-point", help="Make the board the access point of a network of that name."
        ),
    ] = False,
    host: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Name of the board in the network: NAME.local."),
    ] = None,
    tcp: Annotated[
        int | None, typer.Option(metavar="PORT", min=1, max=65535, help="TCP port, 23 by default.")
    ] = None,
    new_key: Annotated[
        bool,
        typer.Option("--new-key", help="Create a new network key; the old one becomes invalid."),
    ] = False,
    off: Annotated[bool, typer.Option("--off", help="Forget the network.")] = False,
) -> None:
    """Set a board's Wi-Fi up, over its cable.

    Without options it shows the current settings and the key.

    New settings take effect at the board's next start. See docs/network.md.
    """
    _check_together(name is not None, open_, access_point, off)
    password = _password(open_) if name is not None else None
    # None leaves a value unchanged.
    wanted = wifi.Wanted(
        name=name,
        password=password,
        is_station=None if name is None else not access_point,
        host=host,
        port=tcp,
    )
    try:
        lines = list(wifi.orders(wanted))
    except ValueError as error:
        raise failed(error) from error
    with connected(port, baud) as connection:
        wifi.set_up(connection, lines)
        if off:
            wifi.switch_off(connection)
        key = wifi.key(connection, new_key)
        network = wifi.status(connection)
    console = Console()
    if lines or off:
        console.print(
            "stored on the board; it takes effect when the board restarts", soft_wrap=True
        )
    console.print(f"network: {network}", highlight=False, soft_wrap=True)
    console.print(f"key:     {key}", highlight=False, soft_wrap=True)


def _check_together(name: bool, open_: bool, access_point: bool, off: bool) -> None:
    """End the command if options that were given exclude each other, or need another one."""
    if not name and (open_ or access_point):
        raise failed("--open and --access-point need the network's --name")
    if open_ and access_point:
        raise failed("the board's own network needs a password: leave out --open")
    if off and name:
        raise failed("use only one of --off and --name")


def _password(is_open: bool) -> str:
    """Return the network's password. It must not appear in the shell's history or on the
    screen."""
    if is_open:
        return ""
    return str(typer.prompt("Password of that network", hide_input=True))
