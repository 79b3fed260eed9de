"""The PIO engine under faults: stops at any instant, exceptions, lost words.

The law: after a stop no further step is made, the position is that of the steps made, and arm()
and start() set the machine in motion again.

fast_rows() makes segments at the highest rate, one for each mask of directions (a bit per motor, 1
is backwards): X and Y make 30 steps in each, Z 7. A bench has the engine on a model of the chip;
chip.run() takes ticks of 80 ns, total_steps() counts the steps of all motors, counted_steps() sums
them per motor, reported_steps() is what the engine reports. restart() starts motion after a stop.
"""

import sys
from array import array
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import accumulate
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
import rp2
from hypothesis import given
from hypothesis import strategies as st
from laws import some
from pio import engine_state, programs
from test_pio import (
    AXES,
    DMA_READINGS,
    MOTORS,
    EngineBench,
    compute_steps,
    engine_bench,
    fast_rows,
    ticks,
    word,
)

# Many cases of each: the first ring runs a sample.
pytestmark = pytest.mark.sampled(2)

pio_model = pytest.importorskip("pio_model", reason="rp2040py has no wheel for this platform")
pioemu = pytest.importorskip("pioemu")

_TXF, _INSTR, _PULL = 0x50200010, 0x502000D8, 0x8080
_BLOCK = 0x100000  # from one PIO to the next
_PIO1, _PIO2 = 0x50300000, 0x50400000
_FDEBUG, _FLEVEL, _INSTR_MEM, _TO_SET = 0x08, 0x0C, 0x48, 0x2000
_SM2_TXF, _SM2_ADDR, _SM2_INSTR = 0x18, 0x104, 0x108
_FIRMWARE = str(Path(engine_state.__file__).parent)


def check_stopped(bench: EngineBench, steps_before: int) -> None:
    """Check that no further step is made until arm(), and that motion works after it.

    steps_before: of all motors, before the stop.
    """
    bench.chip.run(1000)
    assert bench.total_steps() == steps_before
    bench.engine.start()  # without arm()
    bench.chip.run(700)
    assert bench.total_steps() == steps_before, "a stopped engine has been started"
    assert bench.engine.idle()
    assert bench.reported_steps() == bench.counted_steps()
    before = bench.counted_steps()
    # 400 ticks; 3 steps of every motor, from tick 0 to 300; every second motor forwards.
    bench.restart([array("i", [400, 0b01010101, 0, *(3, 0, 300) * bench.motors])]).finish()
    moved = [b - a for a, b in zip(before, bench.counted_steps(), strict=True)]
    assert moved == [-3, 3, -3, 3, -3, 3, -3, 3][: bench.motors]
    assert bench.reported_steps() == bench.counted_steps()
    assert bench.engine.fault() == ""


# Stops


@pytest.mark.parametrize("motors", MOTORS)
@given(st.integers(0, 9000), st.integers(0, 900), DMA_READINGS)
@some(40)
def test_a_stop_at_any_instant_is_exact(
    motors: int, after: int, latency: int, dma: "tuple[bool, int]"
) -> None:
    """after: ticks from the start to the stop; latency: of interrupts, in ticks."""
    with engine_bench(latency=latency, counted=dma[0], flight=dma[1], motors=motors) as bench:
        bench.start(fast_rows([0, 63, 37, 26], motors=motors))
        bench.chip.run(after)
        bench.engine.stop()
        check_stopped(bench, bench.total_steps())


@pytest.mark.parametrize("motors", [3, 6])
@pytest.mark.parametrize("counted", [True, False])
def test_repeated_stops_lose_no_word(counted: bool, motors: int) -> None:
    """Each stop leaves words in FIFOs, in DMA and between them; they must not accumulate.

    Register 0x800 of a channel is its count of free places in a FIFO: there are four.
    """
    with engine_bench(counted=counted, flight=2, motors=motors) as bench:
        for k in range(40):
            bench.restart(fast_rows([0, 63, 5], motors=motors)).chip.run(137 * k % 4001)
            bench.engine.stop()
            assert bench.reported_steps() == bench.counted_steps()
        assert bench.engine.fault() == ""
        assert all(channel.read(0x800) <= 4 for channel in bench.chip.channels)


class Injector:
    """Stop the engine before one line, or one bytecode, of its code.

    A line is identified by its number and by how often it was reached before.
    """

    def __init__(self, bench: EngineBench, opcodes: bool) -> None:
        self.seen: dict[tuple[str, int], int] = {}
        self.stop_point: tuple[tuple[str, int], int] | None = None
        self.steps_at_stop = -1  # steps made when the stop came
        self._bench = bench
        self._event = "opcode" if opcodes else "line"
        self._due = False

    def trace(self, frame: FrameType, event: str, _: Any) -> Any:
        """Count the lines of the engine's code; stop the engine at the chosen one.

        Where it has masked the pins' interrupts, the stop waits for the end of that part.
        """
        code = frame.f_code
        if not code.co_filename.startswith(_FIRMWARE) or self.steps_at_stop >= 0:
            return None
        frame.f_trace_opcodes = self._event == "opcode"
        if event == self._event:
            place = frame.f_lasti if self._event == "opcode" else frame.f_lineno
            key = (code.co_name, place)
            self.seen[key] = count = self.seen.get(key, 0) + 1
            self._due = self._due or (key, count) == self.stop_point
            if self._due and self._bench.chip._pins_may:
                self._stop()
        return self.trace

    def _stop(self) -> None:
        sys.settrace(None)
        self._bench.engine.stop()
        self.steps_at_stop = self._bench.total_steps()
        assert self._bench.reported_steps() == self._bench.counted_steps()


@contextmanager
def stopped_at(
    opcodes: bool, motors: int, stop_point: "tuple[tuple[str, int], int] | None"
) -> "Iterator[Any]":
    """Yield a bench and its injector, after motion with a stop at that point (function, line or
    bytecode, and occurrence); with None there is no stop and all points are recorded."""
    with engine_bench(latency=300, motors=motors) as bench:
        injector = Injector(bench, opcodes)
        injector.stop_point = stop_point
        before = sys.gettrace()
        sys.settrace(injector.trace)
        try:
            bench.start(fast_rows([0, 63, 5], motors=motors))
            bench.chip.run(7000)  # ticks
        finally:
            sys.settrace(before)
        yield bench, injector


def points_of(
    opcodes: bool, motors: int, names: "Iterable[str]"
) -> "Iterator[tuple[tuple[str, int], int]]":
    """Yield every point in these functions (name, line or bytecode), with 1 for its first
    occurrence and the number of its last one."""
    with stopped_at(opcodes, motors, None) as (bench, injector):
        assert bench.finish().reported_steps() == bench.counted_steps()
    wanted = {key: count for key, count in injector.seen.items() if key[0] in names}
    assert {name for name, _ in wanted} == set(names)
    for key, count in wanted.items():
        for which in {1, count}:
            yield key, which


@pytest.mark.parametrize("name", ["start", "request_refill", "_refill"])
def test_a_stop_at_any_bytecode_is_final(name: str) -> None:
    _check_injection(True, AXES, name)


@pytest.mark.sampled(0, 5)
@pytest.mark.parametrize("motors", [3, 6])
@pytest.mark.parametrize(
    "name",
    [
        "read_progress",
        "append",
        "feed_lanes",
        "_prepare",
        "_load_isr",
        "convert",
        "_start_transfer",
        "_launch",
    ],
)
def test_a_stop_at_any_line_is_final(name: str, motors: int) -> None:
    _check_injection(False, motors, name)


def _check_injection(opcodes: bool, motors: int, name: str) -> None:
    """Stop the engine at each line, or bytecode (opcodes), of the function of this name."""
    stops = 0
    for stop_point in points_of(opcodes, motors, [name]):
        with stopped_at(opcodes, motors, stop_point) as (bench, injector):
            assert injector.steps_at_stop >= 0, f"no stop at {stop_point}"
            check_stopped(bench, injector.steps_at_stop)
            stops += 1
    assert stops > 3


@pytest.mark.sampled(0, 2)
@pytest.mark.parametrize("motors", [3, 6])
@pytest.mark.parametrize("work", ["stop", "lock"])
def test_the_engines_interrupt_may_come_during_a_stop(work: str, motors: int) -> None:
    """Motion has just run out of segments, and the interrupt that would start it again is late: it
    comes during stop() or lock(), after some accesses to memory. stop() must win.

    Each round has it two accesses later, until the call ends before it.
    """
    for after in range(1, 600, 2):
        with engine_bench(latency=10_000, motors=motors) as bench:
            bench.start(fast_rows([0, 0, 0, 0], motors=motors))
            bench.chip.run(19_000)  # the clock waits, the interrupt is pending
            steps_before = bench.total_steps()
            assert steps_before == sum(abs(steps) for steps in bench.reported_steps())
            before = bench.chip.accesses
            bench.chip.preempt(after, _interrupt(bench))
            bench.chip.interruptible(bench.engine.stop if work == "stop" else _lock_y(bench))
            bench.chip._preempt = None  # the call may have ended before it
            ended_before = bench.chip.accesses - before < after
            if work == "stop":
                check_stopped(bench, steps_before)
            else:
                y = bench.counted_steps()[1]
                bench.finish()
                assert (
                    bench.counted_steps()[1] == y
                    and bench.reported_steps() == bench.counted_steps()
                )
            if ended_before:
                break
    assert ended_before and after > 10


def _interrupt(bench: EngineBench) -> "Callable[[], None]":
    """Return a function that runs the pending interrupt now."""

    def come() -> None:
        bench.chip._due = None  # it will not come again by itself
        bench.chip.interrupt()

    return come


def _lock_y(bench: EngineBench) -> "Callable[[], None]":
    return lambda: bench.engine.lock(0b010)


# Rest


def test_rest_is_reported_whenever_the_machines_stand_still() -> None:
    """Once after each motion, not before its last pulse (10 us) has begun, and not after
    stop()."""
    rows = fast_rows([0] * 6)
    with engine_bench(latency=40) as bench:
        bench.start(rows).finish()
        assert len(bench.stop_ticks) == 1
        assert bench.stop_ticks[0] >= max(tick for tick, _, _ in bench.chip.edges) - ticks(10)
        bench.start(fast_rows([0])).finish()
        assert len(bench.stop_ticks) == 2
        bench.start(fast_rows([0]))
        bench.chip.run(500)  # ticks: in motion
        bench.engine.stop()
        bench.chip.run(5000)
        assert len(bench.stop_ticks) == 2, "the caller of stop() has switched the tool off"


def test_power_is_reported_again_after_a_rest() -> None:
    """Even if it is the same: the tool was switched off in between."""
    with engine_bench() as bench:
        for _ in range(2):
            rows = fast_rows([0])
            rows[0][2] = 77  # power
            bench.start(rows).finish()
        assert [power for _, power in bench.powers] == [77, 77]


def test_a_pause_resumed_at_once_is_not_reported_as_rest() -> None:
    """The interrupt was late; it makes the next segment and starts it at once."""
    with engine_bench(latency=20_000) as bench:
        bench.start(fast_rows([0] * 8)).finish()
        assert (
            bench.reported_steps() == bench.counted_steps() == [240, 240, 56]
        )  # 8 * 30, 8 * 30, 8 * 7 steps
        assert len(bench.stop_ticks) == 1


# Faults


def _raise(*_: object) -> int:
    raise RuntimeError("maximum recursion depth exceeded")


@pytest.mark.parametrize("motors", [3, 6])
@pytest.mark.parametrize("callback", ["_next_segment", "_on_power", "_on_rest"])
@pytest.mark.parametrize("on_fault_fails", [False, True])
def test_an_exception_in_the_interrupt_stops_everything(
    callback: str, on_fault_fails: bool, motors: int
) -> None:
    """One of the callbacks that the interrupt calls raises.

    on_fault_fails: so does on_fault, which switches the tool off, as without stack space.
    """
    rows = fast_rows([0] * 9, motors=motors)
    for k, row in enumerate(rows):
        row[2] = k  # power: a change in each row calls _on_power
    with engine_bench(motors=motors) as bench:
        bench.start(rows)
        bench.chip.run(3500)
        assert bench.engine.fault() == ""
        callbacks = getattr(bench.engine, callback), bench.engine.on_fault
        setattr(bench.engine, callback, _raise)
        if on_fault_fails:
            bench.engine.on_fault = _raise
        for _ in range(600):
            bench.chip.run(100)
            if bench.engine.fault():
                break
        assert "interrupt has failed" in bench.engine.fault()
        assert len(bench.faults) == (not on_fault_fails)
        setattr(bench.engine, callback, callbacks[0])
        bench.engine.on_fault = callbacks[1]
        bench.engine.stop()
        check_stopped(bench, bench.total_steps())


@pytest.mark.parametrize("motors", [3, 6])
def test_machines_stop_even_if_the_stop_fails(
    monkeypatch: pytest.MonkeyPatch, motors: int
) -> None:
    """As if the stack sufficed for no call: the next segment, halt() and on_fault() fail. The
    machines are off at once, their position is found by stop() later."""
    with engine_bench(motors=motors) as bench:
        bench.start(fast_rows([0] * 9, motors=motors))
        bench.chip.run(1200)
        module = sys.modules[type(bench.engine).__module__]
        with monkeypatch.context() as here:
            here.setattr(module, "halt", _raise)
            bench.engine.on_fault = _raise
            here.setattr(bench.engine, "_next_segment", _raise)
            bench.chip.run(9000)
        steps_before = bench.total_steps()
        assert not bench.engine.idle()
        bench.chip.run(3000)
        assert bench.total_steps() == steps_before
        assert "interrupt has failed" in bench.engine.fault()
        bench.engine.stop()
        check_stopped(bench, steps_before)


@pytest.mark.parametrize(("motors", "lane"), [(3, 0), (6, 4)])
def test_an_extra_word_is_noticed_before_anything_moves(motors: int, lane: int) -> None:
    """A word put into the FIFO and pulled out by hand, as an earlier engine did. DMA then counts
    five free places in a FIFO of four, and sends a word too many.

    lane: the motor, the first one of its PIO.
    """
    with engine_bench(motors=motors) as bench:
        for register, value in ((_TXF, 122), (_INSTR, _PULL)):
            bench.chip.write(register + _BLOCK * (lane // 4), value)
        bench.chip.run(10)
        assert bench.chip.channels[lane].read(0x800) == 5  # register of the free places
        bench.start(fast_rows([0, 63, 0, 63], motors=motors))
        bench.chip.run(9000)
        assert bench.chip.lost() == 1 << lane
        assert "lost" in bench.engine.fault()
        bench.engine.stop()
        steps_before = bench.total_steps()
        bench.engine.start()
        bench.chip.run(3000)
        assert bench.total_steps() == steps_before
        bench.engine.arm()
        assert bench.engine.fault() == ""
        bench.faults.append(0)  # engine_bench() accepts a lost word only with a fault


@pytest.mark.parametrize(("motors", "lane"), [(3, 0), (6, 4)])
def test_a_lost_word_stops_the_engine_before_its_next_start(motors: int, lane: int) -> None:
    """Five words are put into a FIFO of four by hand.

    lane: the motor, the first one of its PIO.
    """
    with engine_bench(motors=motors) as bench:
        for _ in range(5):
            bench.chip.write(_TXF + _BLOCK * (lane // 4), 0)
        assert bench.chip.lost() == 1 << lane
        assert "lost" in bench.engine.fault()
        bench.start(fast_rows([0], motors=motors))
        bench.chip.run(3000)
        assert bench.faults and not bench.total_steps()
        assert "lost" in bench.engine.fault()
        bench.engine.stop()
        bench.engine.arm()
        assert bench.engine.fault() == ""


@pytest.mark.parametrize(("motors", "lane"), [(3, 2), (6, 5)])
def test_a_stuck_dma_channel_is_a_fault(motors: int, lane: int) -> None:
    """With words left to send, it does not advance; no interrupt waits for it forever."""
    with engine_bench(motors=motors) as bench:
        bench.start(fast_rows([0, 63, 5], motors=motors))
        bench.chip.run(2000)
        channel = bench.chip.channels[lane]
        channel.advance = lambda: None  # type: ignore[method-assign]
        channel._left = 3  # words
        bench.engine.stop()
        bench.restart(fast_rows([0], motors=motors))
        bench.chip.run(4000)
        assert bench.faults and "DMA" in bench.engine.fault()


def test_a_missing_interrupt_is_a_fault_until_the_engine_is_armed() -> None:
    """MicroPython disables a handler for good once it has raised. Here a handler that does nothing
    takes its place; PIO.handlers: by PIO, the arguments of irq()."""
    with engine_bench() as bench:
        rp2.PIO.handlers[1] = (lambda _: 0, 0, True)
        bench.start(fast_rows([0]))
        bench.chip.run(100)
        assert "did not occur" in bench.engine.fault()
        bench.engine.stop()
        check_stopped(bench, 0)


@pytest.mark.parametrize("base_us", [0, (1 << 30) - 30_000, (1 << 30) - 1_000])
def test_motion_late_on_its_schedule_is_a_fault(base_us: int) -> None:
    """The clock of microseconds wraps after 18 minutes (1 << 30); the machine may be idle for
    longer without a fault.

    base_us: the clock at the start, also shortly before it wraps.
    """
    with engine_bench() as bench:
        clock = bench.chip.mcu.clock
        clock.tick(base_us * 1000)  # ns
        bench.start(fast_rows([0])).finish()
        for _ in range(4):  # 20 minutes
            assert bench.engine.fault() == ""
            clock.tick(300_000_000_000)
        bench.start(fast_rows([0] * 4))
        bench.chip.run(1000)
        rp2.PIO.handlers[1] = (lambda _: 0, 0, True)  # the interrupt does nothing from now on
        for us in (20_000, 20_000):
            clock.tick(us * 1000)
            assert bench.engine.fault() == ""
        clock.tick(30_000_000)  # 70 ms in all
        assert "later than scheduled" in bench.engine.fault()
        bench.engine.stop()
        check_stopped(bench, bench.total_steps())


def test_fault_messages_contain_no_answer_words() -> None:
    module = sys.modules["pio.engine"]
    for text in module._FAULTS:
        assert "ok" not in text.lower() and "error" not in text.lower()


def test_the_pulse_length_is_loaded_without_the_fifo() -> None:
    """A word put there for it would make DMA lose one of the first words."""
    for us in (3, 10, 255):
        with engine_bench((us, 2, 5)) as bench:
            gap = ticks(us) + 12  # the highest rate
            # 3 steps of each axis, from tick 0 to 2 * gap.
            bench.start([array("i", [4 * gap, 0, 0, *(3, 0, 2 * gap) * AXES])]).finish()
            assert all(seen.pulses == {ticks(us)} for seen in bench.drivers())
            assert bench.chip.lost() == 0


@pytest.mark.parametrize(("motors", "pio"), [(3, _PIO1), (6, _PIO1), (7, _PIO2), (8, _PIO2)])
def test_other_users_of_a_pio_are_left_alone(motors: int, pio: int) -> None:
    """A radio's machine, the third of its PIO, keeps running through stops, faults and starts; its
    words and its FIFO overflow flag stay."""
    with engine_bench(motors=motors) as bench:
        loop = 31  # last address of the PIO: an instruction that jumps to itself
        bench.chip.write(pio + _INSTR_MEM + 4 * loop, loop)
        bench.chip.write(pio + _SM2_INSTR, loop)
        for _ in range(5):  # one more than its FIFO holds
            bench.chip.write(pio + _SM2_TXF, 7)
        bench.chip.write(pio + _TO_SET, 1 << 2)  # CTRL: enable machine 2

        def left_alone() -> bool:
            """Return whether machine 2 runs its loop, with four words and the overflow flag."""
            runs = bench.chip.read(pio) >> 2 & 1
            full = bench.chip.read(pio + _FLEVEL) >> 16 & 15
            over = bench.chip.read(pio + _FDEBUG) >> 18 & 1
            return (runs, full, over, bench.chip.read(pio + _SM2_ADDR)) == (1, 4, 1, loop)

        assert left_alone()
        bench.start(fast_rows([0, 255, 5], motors=motors)).finish()
        assert left_alone() and bench.engine.fault() == ""
        for k in range(5):
            bench.restart(fast_rows([0, 255], motors=motors)).chip.run(900 * k)
            bench.engine.lock(0b10)
            bench.engine.stop()
            assert left_alone()
        bench.restart(fast_rows([0] * 9, motors=motors)).chip.run(300)
        bench.engine._next_segment = _raise
        bench.chip.run(20_000)
        assert "interrupt has failed" in bench.engine.fault()
        assert left_alone()


def test_more_motors_than_machines_are_refused() -> None:
    """An RP2350 has machines for 8 motors, an RP2040 for 6."""
    with pytest.raises(ValueError, match="8 motors at most"), engine_bench(motors=9):
        pass
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pio_model, "MOST_OF_RP2040", 7)  # the model is an RP2040 for 7 motors, too
        with pytest.raises(ValueError, match="6 motors at most"), engine_bench(motors=7):
            pass


# The programs under a second, independent emulator


def _emulated(program: "Sequence[int]", state: Any, count: int) -> "Iterator[Any]":
    """Yield states of a machine that runs a program for count ticks. DIR is pin 0, STEP pin 1."""
    pins = {"out_base": 0, "out_count": 1, "set_base": 1, "set_count": 1}
    for _, after in pioemu.emulate(
        list(program),
        initial_state=state,
        stop_when=lambda _, state: state.clock > count,
        shift_isr_right=False,
        shift_osr_right=True,
        **pins,
    ):
        yield after


_WORD = st.builds(word, st.integers(0, 1), st.integers(0, 5), st.integers(0, 90))


@given(st.lists(_WORD, max_size=7), st.integers(4, 150))
@some(20)
def test_another_emulator_agrees_on_random_words(words: "list[int]", pulse: int) -> None:
    """Every edge of STEP, up and down, in the exact tick that programs.py states."""
    steps, ready = compute_steps(words, pulse)
    isr = pioemu.ShiftRegister(pulse - 3, 32)  # the program takes 3 ticks of each pulse itself
    state = pioemu.State(transmit_fifo=deque(words), input_shift_register=isr)
    edges: list[tuple[int, int]] = []
    level = 0
    for after in _emulated(programs.stepper[0], state, ready + 20):
        if after.pin_values >> 1 & 1 != level:  # STEP has changed
            level = 1 - level
            edges.append((after.clock, after.pin_values & 1))  # tick, DIR
    # This emulator reports the state after an instruction; our model the state before it.
    assert [(tick - 1, direction) for tick, direction in edges[::2]] == steps
    # All pulses, if there are any, have the same length.
    assert {down[0] - up[0] for up, down in zip(edges[::2], edges[1::2], strict=True)} <= {pulse}


def test_another_emulator_agrees_on_the_clock() -> None:
    """The clock's program takes 4 ticks of each segment itself."""
    lengths = [4, 5, 700, 4, 91]
    state = pioemu.State(transmit_fifo=deque(length - 4 for length in lengths))
    program = list(programs.clock[0])
    assert program[0] >> 13 == 6  # IRQ
    program[0] = 0xA042  # no interrupts in this emulator: mov(y, y) takes a tick too
    pulled = [
        after.clock
        for after in _emulated(program, state, sum(lengths) + 50)
        if after.program_counter == programs.CLOCK_PULL + 1
    ]
    # A segment lasts from one pull to the next.
    begun = list(accumulate([pulled[0], *lengths]))
    assert [tick for tick in pulled if tick in begun] == begun[:-1]


@pytest.mark.parametrize("pulse", [4, 125, 3185])
def test_another_emulator_agrees_on_values_forced_into_isr(pulse: int) -> None:
    """The engine loads ISR without the FIFO, by instructions that it makes a machine execute.

    They clear ISR, then shift in 15 bits of the pulse's length, 5 at a time.
    """
    forced = [engine_state._CLEAR_ISR]
    for shift in (10, 5, 0):
        forced += [engine_state._SET_X | pulse >> shift & 31, engine_state._SHIFT_IN]
    dirty = pioemu.ShiftRegister(0xFFFFFFFF, 32)
    *_, last = _emulated(forced, pioemu.State(input_shift_register=dirty), len(forced) - 1)
    assert last.input_shift_register.contents == pulse
