"""The protocol loop in corner cases: which bytes are read, and which are dropped.

A script yields a condition, or the tick at which it is resumed; rig.ms(n) is n ms from now.
"""

import itertools
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from base.errors import Abort
from base.state import State
from fakes import FakeLink
from talk.protocol import Protocol
from ugrbl.boardfile.files import load_board
from ugrbl.sim.link import SimLink
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig
from ugrbl.sim.sender import Sender


class Off(Exception):
    """Power is off."""


class Loop:
    """A protocol loop between fakes. It restarts `restarts` times, then power is off.

    fed: bytes passed to the reader of lines.
    """

    def __init__(self, unread: bytes, restarts: int = 0, by_pin: bool = False) -> None:
        self.link, self.fed = FakeLink(unread), b""
        self.unread_at_starts: "list[bytes]" = []  # unread bytes at each start
        self.motor_control: Any = SimpleNamespace(by_pin=by_pin)
        self._restarts = restarts
        reader: Any = SimpleNamespace(
            feed=self._feed,
            post=None,
            line=bytearray(80),
            memory=lambda: (None, None, bytearray(80), None),
            free=lambda: 255,
        )
        unused: Any = SimpleNamespace(
            due=None,
            machine=None,
            block=SimpleNamespace(ints=None),
            memory=lambda: (None, None, None),
        )
        state = State()
        state.hooks.execute = unused
        machine: Any = SimpleNamespace(
            **dict.fromkeys(("report", "saves", "realtime", "interpreter", "canon"), unused),
            state=state,
            reader=reader,
            motor_control=self.motor_control,
            restart=self._restart,
        )
        self.protocol = Protocol(machine, self.link, echoes=False)

    def _feed(self, buf: bytearray, count: int) -> None:
        self.fed += buf[:count]

    def _restart(self) -> None:
        self.unread_at_starts.append(self.link.unread)
        if len(self.unread_at_starts) > self._restarts:
            raise Off
        raise Abort


def test_received_bytes_are_read_in_pieces_of_half_the_ring() -> None:
    loop = Loop(b"G1X1F100\n" * 20)
    loop.protocol.pump()
    # the ring holds 255 bytes; 180 were sent
    assert loop.fed == (b"G1X1F100\n" * 20)[:127] and len(loop.link.unread) == 180 - 127


def test_bytes_sent_before_a_reset_by_pin_are_dropped() -> None:
    loop = Loop(b"G1X1\n", by_pin=True)
    with pytest.raises(Off):
        loop.protocol.run()
    assert (
        loop.unread_at_starts == [b""] and not loop.motor_control.by_pin
    )  # none left at the restart


def test_the_next_line_is_kept_after_other_resets_even_after_a_fault() -> None:
    """After a fault the loop starts again (its first restart, by_pin still set). $RST= then ends
    with its own Abort: the line sent after its ok is not dropped."""
    loop = Loop(b"", restarts=1, by_pin=True)
    real_restart = loop.protocol.restart

    def restart() -> None:
        loop.link.unread = b"G1X1\n"  # sent right after the ok
        real_restart()

    loop.protocol.restart = restart
    with pytest.raises(Off):
        loop.protocol.run()
    assert loop.link.unread == b"G1X1\n"


class FastLink(SimLink):
    """A link without delay: all bytes arrive at once and wait, as over USB. reads: number of calls
    of read_into()."""

    def __init__(self, rig: Rig) -> None:
        super().__init__(rig, 10 * rig.engine.tick_hz, 10 * rig.engine.tick_hz)
        self.reads = 0

    def read_into(self, buf: bytearray) -> int:
        self.reads += 1
        return super().read_into(buf)


class LoopRecorder:
    """A simulated machine; at each pass of the main loop it records the lines answered and the
    reads so far."""

    def __init__(self) -> None:
        self.answered: "list[int]" = []
        self.reads: "list[int]" = []
        self.answers: "list[str]" = []
        self.rig = Rig(load_board("sim"), factory_store(load_board("sim")), FastLink)
        self.sender = Sender(self.rig)
        self.sender.allow(60_000)
        self.rig.on_built = self._built

    def _built(self) -> None:
        realtime = self.rig.controller.realtime
        handle_events = realtime.handle_events

        def recorded() -> None:
            self.sender.poll()
            self.answered.append(self.sender.answers)
            self.reads.append(self.rig.link.reads)
            handle_events()

        realtime.handle_events = recorded  # type: ignore[method-assign]

    def play(self, text: str) -> None:
        """Answer all lines in check mode, as fast as they can be sent."""

        def script() -> "Iterator[Any]":
            """Switch check mode on, then send the text and wait for all answers."""
            yield from self.sender.wait("banner", "")
            yield from self.sender.wait("ok", "$C\n")
            self.sender.take()
            self.answered[:], self.reads[:] = [0], [self.rig.link.reads]
            yield from self.sender.wait("ok", text)
            self.answers = self.sender.take()

        self.rig.run(script())


def largest_increase(counts: "list[int]") -> int:
    """Return the largest increase of a count from one pass of the loop to the next."""
    return max(b - a for a, b in itertools.pairwise(counts))


@pytest.mark.parametrize(
    "lines",
    [
        [f"X{k % 2}.{k % 7}" for k in range(600)],
        ["G90"] * 200,
        ["F600", "X0", "(nothing)", ""] * 100,
        ([f"X{k}" for k in range(15)] + ["G90"]) * 20,
        ["T1"] * 200,
        *[([f"X{k}" for k in range(count)] + ["T1"]) * 40 for count in (1, 2, 5, 14, 15)],
    ],
)
def test_the_loop_turns_regularly_whatever_lines_are_streamed(lines: "list[str]") -> None:
    machine = LoopRecorder()
    machine.play("".join(line + "\n" for line in ["G1X1F3000", *lines]))
    assert machine.answers == ["ok"] * (len(lines) + 1)  # G1X1F3000, and the lines
    assert largest_increase(machine.answered) <= 18, "too many lines without a turn of the loop"


def test_move_only_lines_do_not_need_a_turn_each() -> None:
    machine = LoopRecorder()
    machine.play("G1X1F3000\n" + "X1\nX2\n" * 300)
    assert len(machine.answered) < 200  # passes, for 601 lines


def test_the_loop_turns_regularly_during_an_endless_line() -> None:
    machine = LoopRecorder()
    machine.play("G1X1F3000\n(" + "x" * 20_000 + ")\n")
    assert machine.answers == ["ok"] * 2
    assert largest_increase(machine.reads) <= 17  # reads per pass


@pytest.mark.parametrize("line", ["G90", "F600", "(nothing)", "X50"])
def test_a_laser_is_off_in_a_hold_whatever_lines_come(line: str) -> None:
    """Within the 25 ms of $1 after motion has stopped, and some more, though 2000 lines arrive
    with the `!`."""
    machine = LoopRecorder()
    sender, rig = machine.sender, machine.rig
    lit_ms: "list[float]" = []

    def script() -> "Iterator[Any]":
        """Hold a move with the laser on, with 2000 lines after the `!`; measure how long it
        burns."""
        yield from sender.wait("banner", "")
        for text in ("$32=1", "M3S500", "G1X50F600"):
            yield from sender.wait("ok", text + "\n")
        yield rig.ms(500)
        rig.link.send(("!" + (line + "\n") * 2000).encode())
        yield lambda: not rig.moving()
        stopped_at = rig.now
        # or after 500 ms, a failure
        yield lambda: rig.port.spindle_pwm == 0 or rig.now > stopped_at + rig.ticks_per_ms * 500
        lit_ms.append((rig.now - stopped_at) / rig.ticks_per_ms)

    rig.run(script())
    assert lit_ms[0] < 60


class Miscounting:
    """cncjs 1.11: it allows 120 unanswered bytes, but counts each resume as an answer.

    unanswered_lengths: as it believes; most_unanswered: bytes that really were, at most.
    """

    def __init__(self, machine: LoopRecorder, lines: "list[str]") -> None:
        self.link, self.sender = machine.rig.link, machine.sender
        self.lines = [line + "\n" for line in lines]
        self.unanswered_lengths: "list[int]" = []
        self.sent = self.counted = self.most_unanswered = 0

    def send_next(self) -> None:
        """Count an answer, and send lines while fewer than 120 bytes count as unanswered."""
        del self.unanswered_lengths[:1]
        while self.sent < len(self.lines):
            line = self.lines[self.sent]
            if sum(self.unanswered_lengths) + len(line) >= 120:
                break
            self.unanswered_lengths.append(len(line))
            self.link.send(line.encode())
            self.sent += 1
        waiting = self.lines[self.sender.answers : self.sent]
        self.most_unanswered = max(self.most_unanswered, sum(map(len, waiting)))

    def poll(self) -> bool:
        """Read the answers; return whether all lines are answered."""
        self.sender.poll()
        for _ in range(self.sender.answers - self.counted):
            self.send_next()
        self.counted = self.sender.answers
        return self.counted == len(self.lines)


def test_a_sender_that_counts_a_resume_as_an_answer_loses_no_line() -> None:
    """After three resumes it sends more than its 120 bytes ahead; the receive buffer must hold
    them all."""
    machine = LoopRecorder()
    rig, sender = machine.rig, machine.sender
    lines = [f"G1 X{k % 2}.{k % 10}00 Y0.{k % 10}00 F1200" for k in range(120)]
    cncjs = Miscounting(machine, lines)

    def script() -> "Iterator[Any]":
        """Stream as cncjs, and hold and resume after 20, 40 and 60 answers."""
        yield from sender.wait("banner", "")
        sender.take()
        sender.allow(300_000)  # ms for all of it
        cncjs.send_next()
        for count in (20, 40, 60):
            yield from sender.until(lambda count=count: cncjs.poll() or cncjs.counted > count)
            rig.link.send(b"!")
            yield rig.ms(300)
            cncjs.poll()
            rig.link.send(b"~")
            cncjs.send_next()
        yield from sender.until(cncjs.poll)
        machine.answers = sender.take()

    rig.run(script())
    assert cncjs.most_unanswered > 150, "unanswered bytes"
    assert machine.answers == ["ok"] * len(lines)
