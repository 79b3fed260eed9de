"""The loop, at its edges: what is read, and what is dropped."""

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
    """The power goes."""


class Loop:
    """A protocol that is restarted so many times, and then goes off."""

    def __init__(self, unread: bytes, restarts: int = 0, by_pin: bool = False) -> None:
        self.link, self.fed = FakeLink(unread), b""
        self.seen: "list[bytes]" = []  # what was unread at each start
        self.drive: Any = SimpleNamespace(by_pin=by_pin)
        self._restarts = restarts
        reader: Any = SimpleNamespace(
            feed=self._feed,
            post=None,
            line=bytearray(80),
            memory=lambda: (None, None, bytearray(80), None),
            free=lambda: 255,
        )
        fast = SimpleNamespace(follow=None, plain=None, memory=tuple)
        nobody: Any = SimpleNamespace(finish=None, fast=fast)
        self.protocol = Protocol(
            *(self.link, State(), reader, nobody, nobody, nobody, self.drive),
            *(nobody, nobody, nobody, self._restart, False),
        )

    def _feed(self, buf: bytearray, count: int) -> None:
        self.fed += buf[:count]

    def _restart(self) -> None:
        self.seen.append(self.link.unread)
        if len(self.seen) > self._restarts:
            raise Off
        raise Abort


def test_what_has_come_is_read_piece_by_piece_of_half_the_ring() -> None:
    loop = Loop(b"G1X1F100\n" * 20)
    loop.protocol.pump()
    assert loop.fed == (b"G1X1F100\n" * 20)[:127] and len(loop.link.unread) == 180 - 127


def test_behind_the_reset_of_a_pin_what_was_sent_before_is_dropped() -> None:
    loop = Loop(b"G1X1\n", by_pin=True)
    with pytest.raises(Off):
        loop.protocol.run()
    assert loop.seen == [b""] and not loop.drive.by_pin


def test_behind_other_resets_the_next_line_is_kept_also_where_a_fault_came_in_between() -> None:
    """A loop that a fault has ended is begun anew; $RST= then ends with an Abort of its own."""
    loop = Loop(b"", restarts=1, by_pin=True)
    kept = loop.protocol._restart

    def restart() -> None:
        loop.link.unread = b"G1X1\n"  # sent right behind the ok
        kept()

    loop.protocol._restart = restart
    with pytest.raises(Off):
        loop.protocol.run()
    assert loop.link.unread == b"G1X1\n"


def _fast_link(rig: Rig) -> SimLink:
    """All that is sent is there at once, and waits, as USB has it."""
    ticks_s = rig.engine.tick_hz
    return SimLink(rig, 10 * ticks_s, 10 * ticks_s)


class Turns:
    """A simulated machine in check mode that notes at which line each turn of the loop came."""

    def __init__(self) -> None:
        self.at: "list[int]" = []
        self.answers: "list[str]" = []
        self._rig = Rig(load_board("sim"), factory_store(load_board("sim")), _fast_link)
        self._sender = Sender(self._rig)
        self._sender.allow(60_000)
        self._rig.on_built = self._built

    def _built(self) -> None:
        realtime = self._rig.controller.realtime
        usual = realtime.events

        def events() -> None:
            self.at.append(self._count())
            usual()

        realtime.events = events  # type: ignore[method-assign]

    def _count(self) -> int:
        self._sender.poll()
        return self._sender.answers

    def play(self, lines: "list[str]") -> None:
        """Have them all answered, as fast as they can be sent."""

        def script() -> "Iterator[Any]":
            yield from self._sender.wait("banner", "")
            yield from self._sender.wait("ok", "$C\n")
            self._sender.take()
            self.at.clear()
            yield from self._sender.wait("ok", "".join(line + "\n" for line in lines))
            self.answers = self._sender.take()

        self._rig.run(script())


def test_the_loop_has_its_turns_while_quick_lines_are_streamed() -> None:
    machine = Turns()
    machine.play(["G1X1F3000", *(f"X{k % 2}.{k % 7}" for k in range(600))])
    assert machine.answers == ["ok"] * 601
    between = [b - a for a, b in itertools.pairwise(machine.at)]
    assert max(between) <= 18, "lines without a look at what else there is"
    assert len(between) < 200, "quick lines are not one by one the loop's"
