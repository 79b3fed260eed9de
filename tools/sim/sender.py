"""A sender at the rig: sends what a recording says, and waits as the recorder did."""

from base import state

from .rig import Rig

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    Script = Generator[int | Callable[[], bool], None, None]

# Silence, in ms, that ends a step, by how it waits: see Sender.wait().
_SETTLE = {"ok": 20, "idle": 20, "stream": 20, "report": 5, "banner": 60}
WINDOW = 127  # unanswered bytes while streaming
_REACT_MS = 2  # after the last byte; the firmware may be idle before because it has not read it


class TooLong(Exception):
    """A wait did not end within its limit."""


def to_bytes(text: str) -> bytes:
    """Convert text to bytes, a byte per character."""
    return bytes([ord(c) for c in text])


def to_text(data: "bytes | bytearray") -> str:
    """Convert bytes to text, a character per byte."""
    return "".join([chr(b) for b in data])


def is_answer(line: str) -> bool:
    """Return whether the line is an answer."""
    return line == "ok" or line.startswith("error:")


class Sender:
    """Sends to a rig and waits as the recorder did. Waits are generators for a rig's script."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.lines: "list[str]" = []  # received since take()
        self.answers = 0  # how many of them are answers
        self.deadline = 0  # tick at which waits end with TooLong

    def take(self) -> "list[str]":
        """Return the lines received since the last call."""
        self.poll()
        lines = self.lines
        self.lines = []
        self.answers = 0
        return lines

    def partial(self) -> str:
        """Return the received part of an unfinished line."""
        return to_text(self.rig.link.received)

    def poll(self) -> None:
        """Split received bytes into lines."""
        link = self.rig.link
        if link.received:
            text = to_text(link.received)
            if "\r\n" in text:
                lines = text.split("\r\n")
                link.received = bytearray(to_bytes(lines.pop()))  # the unfinished line
                for line in lines:
                    self.lines.append(line)
                    self.answers += is_answer(line)

    def allow(self, milliseconds: float) -> None:
        """Set the time limit of all following waits."""
        self.deadline = self.rig.ms(milliseconds)

    def until(self, condition: "Callable[[], bool]") -> "Script":
        """Wait until condition() is true; TooLong at the deadline."""

        def has_ended() -> bool:
            self.poll()
            return condition() or self.rig.now >= self.deadline

        if not has_ended():
            yield has_ended  # the rig resumes this when it returns True
        if not condition():
            raise TooLong()

    def silence(self, since: int, milliseconds: int) -> "Script":
        """Wait until nothing has arrived for so many ms, counted from tick `since` on at the
        earliest."""
        rig = self.rig
        while True:
            end = max(since, rig.link.last_arrival) + int(milliseconds * rig.ticks_per_ms)
            if rig.now >= end:
                return
            if rig.now >= self.deadline:
                raise TooLong()
            yield end

    def stream(self, lines: "list[str]") -> "Script":
        """Send by character counting until every line is answered. lines: with their ends."""
        lengths: "list[int]" = []  # of the lines without an answer
        unanswered = 0  # their bytes
        counted = self.answers  # number of answers taken into account

        def has_new_answer() -> bool:
            return self.answers > counted

        for line in lines:
            while unanswered + len(line) > WINDOW and lengths:
                yield from self.until(has_new_answer)
                unanswered -= lengths.pop(0)
                counted += 1
            lengths.append(len(line))
            unanswered += len(line)
            self.rig.link.send(to_bytes(line))
        all_answers = counted + len(lengths)
        yield from self.until(lambda: self.answers >= all_answers)

    def at_rest(self) -> bool:
        """Return whether motion has ended and no more follows by itself, as the recorder
        determined it by reading the chip: also in a completed hold, an alarm, or sleep."""
        rig = self.rig
        controller = rig.controller
        if controller is None or rig.moving():
            return False
        machine = controller.state
        if machine.run & (state.HOLD | state.DOOR):
            return bool(machine.suspend & state.HOLD_COMPLETE)
        if machine.run in (state.ALARM, state.SLEEP):
            return True
        return machine.run in (state.IDLE, state.CHECK) and controller.planner.empty()

    def wait(self, how: str, text: str, settle: "int | None" = None) -> "Script":
        """Send text and wait as a step object says.

        how: `ok`: until every line is answered; `idle`: until motion has ended, too; `stream`:
        the same as `ok` while sending by character counting; `report`, `banner`: until one has
        come; `ms 50`: so long. settle: ms of silence that end it; None: those of _SETTLE.
        """
        rig = self.rig
        if how == "stream":
            yield from self.stream([line + "\n" for line in text.split("\n")[:-1]])
            since = rig.now
        else:
            since = rig.link.send(to_bytes(text))  # tick at which the last byte arrives
            wanted = text.count("\n") + text.count("\r")  # answers: each of both ends a line
            if how.startswith("ms "):
                yield since + int(float(how[3:]) * rig.ticks_per_ms)
                return
            if how == "report":
                yield from self.until(lambda: any(line.startswith("<") for line in self.lines))
            elif how == "banner":
                yield from self.until(lambda: any(line.startswith("Grbl") for line in self.lines))
            elif how in ("ok", "idle"):
                yield from self.until(lambda: self.answers >= wanted)
            else:
                raise ValueError("unknown wait: " + how)
        if how == "idle":
            has_reacted = since + int(_REACT_MS * rig.ticks_per_ms)
            yield from self.until(lambda: rig.now >= has_reacted and self.at_rest())
            since = rig.now
        yield from self.silence(since, _SETTLE[how] if settle is None else settle)
