"""Run a program through the firmware in virtual time, as fast as the computer can."""

from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

from ..grbl.gcode_file import CYCLE_START, RESET, has_realtime, is_answer, is_welcome
from ..grbl.messages import refusal
from . import machine
from .checked_lines import CheckedLines
from .pace import Paced
from .recorder import Recorder, Totals

if TYPE_CHECKING:
    from ..sim.rig import Rig

_Watcher = TypeVar("_Watcher", bound=Recorder)

# Bytes sent and not yet answered: the limit that senders keep.
_WINDOW = 127
# A longer line is passed in pieces, so that the firmware can make space.
_PIECE = 64
# Reads without data before the firmware is assumed to wait for the machine.
_IDLE_READS = 3
# A held machine gets another cycle start after this time.
_RESUME_MS = 500
_PROGRESS_LINES = 100
_BATCH_LINES = 1000
# Without motion and answers for so long, the program has stalled.
_STALLED_MS = 6 * 3600 * 1000
# Time limit for a handler of the user's own that waits without output.
_WAITING_MS = 10 * 60 * 1000


@dataclass
class Result:
    """The result of a program. Lines count from 1."""

    lines: int = 0  # number of lines answered
    errors: list[tuple[int, str]] = field(default_factory=list)
    other_output: list[tuple[int, str]] = field(default_factory=list)
    final_state: str = ""
    pauses: list[int] = field(default_factory=list)
    resets: list[int] = field(default_factory=list)  # lines with a Ctrl-X
    stopped: str = ""  # why it did not finish; "" if it did
    # line, name and level of outputs of custom.py
    switched: list[tuple[int, str, bool]] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)  # failures of handlers of custom.py
    # line and description of unusual arcs
    wide_arcs: list[tuple[int, str]] = field(default_factory=list)
    own: str = ""  # handlers of custom.py, as $I names them
    totals: Totals = field(default_factory=Totals)

    def as_json(self) -> dict[str, Any]:
        """Return the result for `ugrbl run --json`."""
        return {
            "lines": self.lines,
            "errors": self.errors,
            **vars(self.totals),
            "final_state": self.final_state,
            "other_output": self.other_output,
            "pauses": self.pauses,
            "resets": self.resets,
            "stopped": self.stopped,
            "switched": self.switched,
            "faults": self.faults,
            "wide_arcs": self.wide_arcs,
        }


# The sender's next action.
Step = tuple[int, bytes] | None  # number (0: not in the program) and line; None: wait until idle
_NOT_OF_PROGRAM = 0  # as a line number


class ProgramLink(machine.UntimedLink):
    """A Link whose sender has a whole program available, over a wire without delay.

    It keeps the firmware's receive buffer full, answers a hold with a cycle start, and switches
    the machine off when its script ends.
    """

    def __init__(self, rig: "Rig", script: Callable[["ProgramLink"], Iterator[Step]]) -> None:
        self.rig = rig
        self.result = Result()
        self.replies: list[str] = []  # to lines that are not in the program
        self._greeted = False  # the banner has come; nothing is sent before
        self._script = script(self)
        self._next_step: Step = None  # the next one
        self._sent = 0  # number of lines of the program
        self._unanswered: deque[tuple[int, int]] = deque()  # line number, bytes
        self._unanswered_bytes = 0
        # The last line has a real-time command, so it must be answered before another is sent.
        self._holds_back = False
        self._buffer_is_full = False  # the next line does not fit until another is answered
        self._answered_line = _NOT_OF_PROGRAM  # the last line answered
        self._to_firmware = bytearray()  # sent, and not yet read by the firmware
        self._begun_output = ""  # the beginning of an output line
        self._idle_reads = 0  # reads without data since the last byte
        self.last_event: int = rig.now  # tick of the last event
        self._next_resume = 0  # tick of the next cycle start for a held machine

    def program(
        self,
        lines: Sequence[bytes],
        progress: Callable[[int], None] | None = None,
        plain: bool = False,
    ) -> Iterator[Step]:
        """Yield the steps that send a program, or its next part.

        progress: called at times with the number of lines sent. plain: in check mode, move-only
        lines go directly to the firmware's kernels, many at a time.
        """
        checked_lines = CheckedLines(self.rig) if plain else None
        for begin in range(0, len(lines), _BATCH_LINES):
            batch = list(lines[begin : begin + _BATCH_LINES])
            kernels = checked_lines if checked_lines and checked_lines.load(batch) else None
            index = 0
            while index < len(batch):
                if kernels:
                    yield None  # until all lines that were sent are done
                    index += self._count_checked(kernels.check())
                if index < len(batch):
                    self._sent += 1
                    yield self._sent, batch[index]
                    index += 1
                if progress and (index == len(batch) or index % _PROGRESS_LINES == 0):
                    progress(self._sent)

    def _count_checked(self, checked: int) -> int:
        """Count lines that were accepted without having been sent. Returns their number."""
        self._sent += checked
        self.result.lines += checked
        self._answered_line = self._sent
        return checked

    # The Link interface

    def read_into(self, buf: bytearray) -> int:
        """Put the next bytes of the program into buf, and return how many; if there are none, time
        passes."""
        if self._greeted and not self._to_firmware and not self._buffer_is_full:
            self._fill_buffer()
        if not self._to_firmware:
            self._idle_reads += 1
            # The firmware reads some times before it waits for the machine.
            if self._idle_reads > _IDLE_READS or self._waits_for_motors():
                self._pass_time()
            return 0
        self._idle_reads = 0
        piece = _PIECE if len(self._to_firmware) > _WINDOW else _WINDOW
        count = min(len(buf), len(self._to_firmware), piece)
        buf[:count] = self._to_firmware[:count]
        del self._to_firmware[:count]
        return count

    def write(self, data: "bytes | bytearray | memoryview") -> None:
        """Receive the firmware's output."""
        self._idle_reads = 0
        self._begun_output += bytes(data).decode("latin-1")
        *lines, self._begun_output = self._begun_output.split("\r\n")
        for line in lines:
            self._receive(line)

    # Replies

    def _receive(self, line: str) -> None:
        """Process a line of the firmware's output."""
        self.last_event = self.rig.now
        if self.result.stopped:
            return  # lines already passed are refused in alarm; this is no event
        if is_answer(line):
            if self._unanswered:
                self._answer(line)
        elif is_welcome(line):
            self._greeted = True
            self._buffer_is_full = False
            self._unanswered.clear()
            self._unanswered_bytes = 0
        elif line:
            self._other(line)

    def _answer(self, line: str) -> None:
        """Process the answer to the oldest line that has none."""
        self._answered_line, length = self._unanswered.popleft()
        self._unanswered_bytes -= length
        self._buffer_is_full = False
        if self._answered_line == _NOT_OF_PROGRAM:
            self.replies.append(line)
            return
        self.result.lines += 1
        if line != "ok":
            self.result.errors.append((self._answered_line, line))

    def _other(self, line: str) -> None:
        """Process output that is no answer. An alarm stops the program."""
        if self.now_at() == _NOT_OF_PROGRAM:
            self.replies.append(line)
        else:
            self.result.other_output.append((self.now_at(), line))
        if line.startswith("ALARM:"):
            self.stop(line)

    def now_at(self) -> int:
        """Return the line of the program that is being interpreted; _NOT_OF_PROGRAM if it is
        another one."""
        from language.block_layout import LINES_LEFT

        # The number of lines interpreted and not yet answered: 0 or 1. The next line follows it.
        interpreted = self.rig.controller.interpreter.machine[LINES_LEFT] & 1
        if interpreted < len(self._unanswered):
            return self._unanswered[interpreted][0]
        return self._unanswered[-1][0] if self._unanswered else self._answered_line

    def note_output(self, name: str, on: bool) -> None:
        """Note that a handler has switched an output."""
        self.result.switched.append((self.now_at(), name, on))

    # Output

    def _fill_buffer(self) -> None:
        """Put as many lines into _to_firmware as the firmware can take. When the script has ended,
        or was stopped, power_off() raises PowerOff."""
        if self.result.stopped:
            self.rig.power_off()
        while self._next_step is not None or self._is_idle():
            if self._next_step is not None:
                if not self._fits(self._next_step[1]):
                    self._buffer_is_full = True
                    return
                self._send(*self._next_step)
            try:
                self._next_step = next(self._script)
            except StopIteration:
                self.rig.power_off()

    def _fits(self, line: bytes) -> bool:
        """Return whether a line can be sent now."""
        if not self._unanswered:
            return True
        if self._holds_back or has_realtime(line):
            return False
        return self._unanswered_bytes + len(line) < _WINDOW

    def _send(self, number: int, line: bytes) -> None:
        """Send a line, and expect an answer to it."""
        self._to_firmware += line + b"\n"
        self._unanswered.append((number, len(line) + 1))
        self._unanswered_bytes += len(line) + 1
        self._holds_back = has_realtime(line)
        if RESET in line and number:
            self.result.resets.append(number)

    def stop(self, why: str) -> None:
        """Send no more lines."""
        self._buffer_is_full = False
        if not self.result.stopped:
            self.result.stopped = why

    def _is_idle(self) -> bool:
        """Return whether everything is answered and nothing moves or is about to move."""
        from base import state

        rig = self.rig
        if self._unanswered or rig.moving() or not rig.controller.planner.empty():
            return False
        return rig.controller.state.run in (state.IDLE, state.CHECK, state.ALARM)

    # Time

    def _waits_for_motors(self) -> bool:
        """Return whether nothing can happen before the motors have finished a block: the planner
        is full, and the machine runs undisturbed."""
        from base import state
        from motion.layout import HEAD, ROWS, TAIL

        controller = self.rig.controller
        flow, machine = controller.planner.flow, controller.state
        is_planner_full = (flow[HEAD] + 1 - flow[TAIL]) % flow[ROWS] == 0
        return (
            is_planner_full
            and machine.run == state.RUN
            and not (machine.suspend or machine.pending[state.ANY])
            and self.rig.moving()
        )

    def _pass_time(self) -> None:
        """Let motion continue, resume a held machine, or stop if nothing can happen any more.
        Called when the firmware waits for the machine."""
        from base import state

        rig = self.rig
        run = rig.controller.state.run
        if rig.moving():
            self.last_event = rig.now
        elif run & (state.HOLD | state.DOOR) and rig.now >= self._next_resume:
            self._resume()
            return
        elif run == state.SLEEP:
            self.stop("asleep ($SLP)")
        elif rig.now - self.last_event > _STALLED_MS * rig.ticks_per_ms:
            self.stop("the machine is stuck: nothing happens any more")
        elif rig.custom_module and rig.custom_module.running:
            self._watch_handler(rig.custom_module.running[-1])
        rig.skip()
        if rig.inputs:
            rig.inputs.advance()

    def _watch_handler(self, name: str) -> None:
        """Stop if a handler of custom.py waits too long without motion."""
        if self.rig.now - self.last_event > _WAITING_MS * self.rig.ticks_per_ms:
            minutes = _WAITING_MS // 60_000
            time = f"{minutes} minute{'s' * (minutes > 1)}"
            self.stop(
                f"{name} has waited for {time}: what it waits for never comes in the simulator"
            )

    def _resume(self) -> None:
        """Send a cycle start, and note the line of the pause. No other cycle start is sent before
        the tick _next_resume, so that the firmware has time to go on."""
        self._to_firmware += CYCLE_START
        self._next_resume = self.rig.ms(_RESUME_MS)
        if self.now_at() not in self.result.pauses[-1:]:  # each line once
            self.result.pauses.append(self.now_at())


def run_program(
    lines: Sequence[bytes],
    *,
    board: str = machine.DEFAULT_BOARD,
    settings: Sequence[str] = (),
    check: bool = False,
    progress: Callable[[int], None] | None = None,
    around: machine.Around = machine.NOTHING,
) -> tuple[Result, Paced]:
    """Run a program on a machine with factory settings. settings: lines such as `$110=6000`.

    progress: called at times with the number of lines sent.
    """
    commands = (*settings, *(["$C"] if check else []))
    return watch_program(lines, Paced, board, commands, progress, around=around)


def watch_program(
    lines: Sequence[bytes],
    watcher: "Callable[[Rig], _Watcher]",
    board: str,
    commands: Sequence[str],
    progress: Callable[[int], None] | None,
    coarse: int = 1,
    around: machine.Around = machine.NOTHING,
) -> tuple[Result, _Watcher]:
    """Run a program, after commands that must be accepted, with a Recorder made by `watcher`.

    coarse: see Rig.
    """

    def script(link: ProgramLink) -> Iterator[Step]:
        """Send commands, then the program with the clock running, then ask for the modes."""
        if not (yield from _prepare(link, commands)):
            return
        watching.start_clock()
        yield from link.program(lines, progress, watching.is_plain)
        yield None
        watching.stop_clock(link.last_event)
        link.replies.clear()
        yield 0, b"$G"
        yield None
        modes = [reply for reply in link.replies if reply.startswith("[G")]
        link.result.final_state = modes[0] if modes else ""

    rig = machine.build(board, lambda rig: ProgramLink(rig, script), coarse=coarse, around=around)
    if rig.custom_module:
        rig.custom_module.on_endless_wait = rig.link.stop
        rig.custom_module.on_switched = rig.link.note_output
    watching = watcher(rig)
    machine.run(rig)
    result: Result = rig.link.result
    result.totals = watching.totals()
    result.wide_arcs = watching.wide_arcs
    result.faults = rig.custom_module.faults if rig.custom_module else []
    return result, watching


def _prepare(link: ProgramLink, commands: Sequence[str]) -> Generator[Step, None, bool]:
    """Unlock the machine and send it commands. Returns whether it accepted them all."""
    from base import state

    if link.rig.controller.state.run == state.ALARM:
        yield 0, b"$X"
    for command in commands:
        link.replies.clear()
        yield 0, command.encode("latin-1")
        yield None
        if link.replies[-1] != "ok":
            link.stop(refusal(command, link.replies[-1]))
            return False
    return True
