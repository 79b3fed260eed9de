"""Storms of edges in virtual time: one processor, whose interrupts take their real time.

On an RP2040 interrupts of pins come before those of timers and of the engine, and these before the
main loop; an edge during another interrupt waits in a latch. On an ESP32 all of them wait for one
of eight places between two bytecodes (esp_clock.py). The handlers are the firmware's own.
"""

from collections.abc import Callable
from typing import Any

import machine
from esp_bench import clock, esp_machine
from machine import Pin

# Duration of emulated interrupts of pins: until the pin is read, and the rest.
_ENTRY_US, _REST_US = 12, 28
_TIMER_US = 40  # a timer's interrupt
_REFILL_US, _REFILL_EVERY_US = 1_500, 5_000  # the engine's
_TURN_US = 100  # a piece of the main loop's work
_NEVER = 1 << 60


class Cpu:
    """An RP2040. turn: called in each turn of the main loop."""

    def __init__(self) -> None:
        self.us = 0
        self.turn: Callable[[], None] = lambda: None
        self.turns = 0
        self.late_us = 0  # longest delay of an interrupt of the engine or a timer
        self.calls: list[int] = []  # times of pin interrupts
        self._timers: dict[Any, int] = {}  # when each is due
        self._refill = _REFILL_EVERY_US
        self._edges: list[tuple[int, Pin, int]] = []  # of the storm, the next one last

    def timer(self) -> type[machine.Timer]:
        """Return a class of timers that use this clock."""
        timers, now = self._timers, lambda: self.us

        class VirtualTimer(machine.Timer):
            def init(self, *, period: int = -1, **how: Any) -> None:
                super().init(period=period, **how)
                timers[self] = now() + 1000 * period

            def deinit(self) -> None:
                super().deinit()
                timers.pop(self, None)

        return VirtualTimer

    def storm(self, pins: "list[Pin]", open_us: int, closed_us: int, us: int) -> None:
        """Send edges to all these pins for us microseconds, and advance the time. The pins end
        open."""
        at, level, edges = self.us, 1, []
        while at < self.us + us:
            at += (closed_us, open_us)[level]
            level = 1 - level
            edges += [(at, pin, level) for pin in pins]
        self._edges = edges[::-1]
        self.run(us)
        self._edges.clear()
        for pin in pins:
            pin.drive(1)

    def run(self, us: int) -> None:
        """Advance the time."""
        end = self.us + us
        while self.us < end:
            self._interrupts()
            timer = min(self._timers, key=lambda timer: self._timers[timer], default=None)
            due = self._timers.get(timer, _NEVER)
            if min(due, self._refill) > self.us:
                self._spend(min(_TURN_US, due - self.us, self._refill - self.us))
                self.turns += 1
                self.turn()
            elif due <= self._refill:
                self.late_us = max(self.late_us, self.us - due)
                self._timers[timer] = due + 1000 * timer.period
                timer.expire()
                self._spend(_TIMER_US)
            else:
                self.late_us = max(self.late_us, self.us - self._refill)
                self._refill += _REFILL_EVERY_US
                self._spend(_REFILL_US)

    def _spend(self, us: int, urgent: bool = False) -> None:
        """Advance by this much work; pin interrupts may come in between, but not into each
        other."""
        while us > 0:
            gap = min(us, self._edges[-1][0] - self.us) if self._edges else us
            self.us += gap
            us -= gap
            while self._edges and self._edges[-1][0] <= self.us:
                _, pin, level = self._edges.pop()
                pin.drive(level)
            if not urgent:
                self._interrupts()

    def _interrupts(self) -> None:
        while Pin.latched:
            pin = Pin.latched.pop(0)
            self.calls.append(self.us)
            self._spend(_ENTRY_US, True)
            pin.interrupt()
            self._spend(_REST_US, True)


class SoftCpu:
    """An ESP32, whose engine needs a turn each millisecond."""

    def __init__(self) -> None:
        self.calls: list[int] = []
        self.turns = 0
        self.late_us = 0
        self._looked = clock.us
        self._engine = esp_machine.Timer(0)
        self._engine.init(period=1, callback=self._turn)

    def _turn(self, _: object) -> None:
        self.late_us = max(self.late_us, clock.us - self._looked - 1000)
        self._looked = clock.us
        self.turns += 1

    def storm(self, pins: "list[Any]", open_us: int, closed_us: int, us: int) -> None:
        """Do the same; MicroPython runs C code during every other half millisecond."""
        end, level = clock.us + us, 1
        handlers = [self._counted(pin) for pin in pins]
        while clock.us < end:
            clock.busy = clock.us // 500 % 2 == 1
            self._pass((closed_us, open_us)[level])
            level = 1 - level
            for pin in pins:
                pin.drive(level)
        clock.busy = False
        for pin, handler in zip(pins, handlers):
            pin.drive(1)
            pin.handler = handler

    def run(self, us: int) -> None:
        """Advance the time."""
        clock.advance(clock.us + us)

    def _pass(self, us: int) -> None:
        if clock.busy:
            clock.work(us)
        else:
            clock.advance(clock.us + us)

    def _counted(self, pin: Any) -> Any:
        handler = pin.handler

        def interrupt(pin: Any) -> None:
            self.calls.append(clock.us)
            clock.work(_ENTRY_US)
            handler(pin)
            clock.work(_REST_US)

        pin.handler = interrupt
        return handler
