"""Serial ports, and which of them may have a Grbl."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, NamedTuple

import typer
from rich.console import Console
from serial.tools import list_ports

from ..device.connection import Connection, SendError
from ..device.settings_sync import connect
from .outputs import failed

# Options of all commands that communicate with a machine.
Port = Annotated[
    str | None,
    typer.Option(metavar="PORT", help="Serial port or simulator. [default: the only one]"),
]
Baud = Annotated[
    int, typer.Option(metavar="RATE", min=50, help="Baud rate of a real serial port.")
]

# USB vendor and product (0: any) of controllers and their serial bridges.
_KNOWN = (
    (0x2E8A, 0x0005, "Raspberry Pi Pico with MicroPython"),
    (0x2E8A, 0x000A, "Raspberry Pi Pico with a program in C"),
    (0x2E8A, 0, "Raspberry Pi RP2 chip"),
    (0x303A, 0, "ESP32 with USB of its own"),
    (0x10C4, 0xEA60, "CP210x bridge, as on many ESP32 boards"),
    (0x1A86, 0x7523, "CH340 bridge, as on ESP32 boards and copies of the Arduino"),
    (0x1A86, 0x55D4, "CH9102 bridge, as on ESP32 boards"),
    (0x0403, 0x6001, "FTDI bridge, as on older Arduinos"),
    (0x2341, 0, "Arduino"),
    (0x2A03, 0, "Arduino"),
)


class Found(NamedTuple):
    """A port, and what is plugged in there."""

    port: str
    what: str


def find() -> list[Found]:
    """Return the ports that may have a controller, recognised by their USB numbers."""
    controllers = []
    for port in list_ports.comports():
        for vendor, product, name in _KNOWN:  # product 0: any
            if port.vid == vendor and product in (0, port.pid):
                controllers.append(Found(port.device, name))
                break
    return controllers


def command(
    json_out: Annotated[bool, typer.Option("--json", help="Print the list as JSON.")] = False,
) -> None:
    """List the serial ports that may have a controller.

    The exit code is 1 if there is none.
    """
    controllers = find()
    if json_out:
        print(json.dumps([found._asdict() for found in controllers], indent=1))
    for found in [] if json_out else controllers:
        Console().print(f"{found.port}: {found.what}", highlight=False, soft_wrap=True)
    if not controllers:
        Console(stderr=True).print("no controller was found on USB")
        raise typer.Exit(1)


def choose(port: str | None) -> str:
    """Return the given port, or the only one there is; SendError if there is none or several."""
    if port:
        return port
    controllers = find()
    if not controllers:
        raise SendError("no controller was found on USB; if there is one, name its port: --port")
    if len(controllers) > 1:
        listed = ", ".join(f"{found.port} ({found.what})" for found in controllers)
        raise SendError(f"there are several: {listed}; choose one with --port")
    return controllers[0].port


@contextmanager
def connected(port: str | None, baud: int) -> Iterator[Connection]:
    """Yield a connected Grbl; a failure ends the command with a message."""
    try:
        connection = connect(choose(port), baud)
        try:
            yield connection
        finally:
            connection.close()
    except SendError as error:
        raise failed(error) from error
