"""Read settings from a Grbl on a port, and write them."""

from collections.abc import Callable, Sequence

from ..grbl.gcode_file import is_welcome
from ..grbl.messages import meaning
from ..grbl.settings_file import Change, Firmware, Settings, changes
from .connection import BAUD, Connection, SendError, way_out

_ANSWER_S = 5.0
# States in which Grbl answers all questions about itself.
QUIET = ("Idle", "Alarm")
_SOFT_LIMITS = 20


class Refused(Exception):
    """Settings that the machine refused, each as (change, reply)."""

    def __init__(self, refusals: Sequence[tuple[Change, str]]) -> None:
        lines = ((f"${change.number}={change.after}", reply) for change, reply in refusals)
        super().__init__("; ".join(f"{line}: {r}: {meaning(r, line)}" for line, r in lines))
        self.refusals = refusals


def connect(port: str, baud: int = BAUD) -> Connection:
    """Connect to a Grbl that answers, in any state. SendError if none does."""
    connection = Connection(port, baud)
    if not connection.wait_for(lambda line: line.startswith("<"), _ANSWER_S):
        connection.close()
        raise SendError(
            f"no Grbl answers on {port}; `ugrbl doctor --port {port}` looks for the cause"
        )
    return connection


def pull(connection: Connection) -> Settings:
    """Read all settings, and which firmware has them. SendError if the machine's state does not
    allow it."""
    state = connection.state()  # "": not known
    if state and state not in QUIET:
        raise SendError(
            f"the machine is in {state} and does not report its settings: {way_out(state)} first"
        )
    info = _ask(connection, "$I")
    values = _ask(connection, "$$")
    settings = Settings.read("\n".join(line for line in values if line.startswith("$")))
    settings.firmware = Firmware.read(info)
    return settings


def push(
    connection: Connection, todo: Sequence[Change], progress: Callable[[Change], None]
) -> None:
    """Write settings and read them back; raises Refused with those that were refused, or that read
    back differently. All others are stored. progress: called with each that was accepted.

    A value may be refused as long as another one is not changed ($20 needs $22, a rate may be too
    high for a resolution), so refused values are tried again after the others.
    """
    remaining = sorted(todo, key=lambda change: (change.number == _SOFT_LIMITS, change.number))
    while remaining:
        refused: list[tuple[Change, str]] = []
        for change in remaining:
            reply = connection.ask(f"${change.number}={change.after}")[-1]
            if reply == "ok":
                progress(change)
            else:
                refused.append((change, reply))
        if len(refused) == len(remaining):
            raise Refused(refused)
        remaining = [change for change, _ in refused]
    wanted = {change.number: change.after for change in todo}
    unlike = changes(pull(connection).values, wanted)
    if unlike:
        raise Refused([(change, f"it says {change.before}") for change in unlike])


def factory(connection: Connection) -> None:
    """Restore the factory settings ($RST=$); the firmware then restarts."""
    connection.write(b"$RST=$\n")
    if not connection.wait_for(is_welcome, _ANSWER_S):
        raise SendError("the machine did not restore its settings: is it idle?")


def _ask(connection: Connection, line: str) -> list[str]:
    """Send a line and return its replies. SendError if it is refused."""
    replies = connection.ask(line)
    if replies[-1] != "ok":
        raise SendError(f"{line}: {replies[-1]}: {meaning(replies[-1], line)}")
    return replies
