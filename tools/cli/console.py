"""The command `ugrbl console`."""

import asyncio
import sys

from ..device.connection import BAUD, ONLY_RESET, Connection, SendError
from .outputs import examples, failed
from .ports import Baud, Port, choose
from .session import Session

EXAMPLES = examples(
    "ugrbl console",
    "ugrbl console --port /dev/ttyACM0",
)


def command(
    port: Port = None,
    baud: Baud = BAUD,
) -> None:
    """Talk to a Grbl in a terminal made for it.

    It shows the state, has a history, and explains settings and errors. Tab switches between lines
    and keys. Keys jog while they are held, set zero, home, unlock, hold, and change feed, rapids
    and spindle. Ctrl-X resets the machine.
    """
    from .terminal import Terminal

    if not sys.stdin.isatty():
        raise failed("the console needs a terminal; `ugrbl send -` sends lines from stdin")
    try:
        connection = Connection(choose(port), baud)
        session = Session(connection, print)
        try:
            if not connection.answers():
                print(f"no Grbl answers on this port; {ONLY_RESET}")
            asyncio.run(Terminal(session).run())
        finally:
            session.leave()
            connection.close()
    except SendError as error:
        raise failed(error) from error
