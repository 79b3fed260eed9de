# mypy: ignore-errors
"""Limit inputs: force their interrupts, and record what motors and spindle do then."""

import gc
import time
from array import array

import board
import micropython
from machine import Timer, mem32

from .config import CONFIG
from .drive import WATCHED, sampler
from .rows import AXES, random_between, settle
from .say import say
from .watch import CLEAR, FIRST, LAST, PIO1, SET, TICK_HZ

PINS = CONFIG["io_bank"]  # the pins' registers: STATUS and CTRL of each pin alternate
INVERT = 1 << 28  # IRQOVER in CTRL: inverts the interrupt input, so that any level gives an edge
TO_PROCESSOR = 26  # bit of STATUS: the interrupt, after override
BEFORE = 400  # ticks sampled before the edge

# Places in `plan`, the argument of shoot().
DMA = 0  # address of the DMA channel's registers
WRITE = 1  # address of the samples
COUNT = 2  # number of samples
ENABLE = 3  # address of the register that starts the sampling machine
REMAINS_AT = 4  # samples still to come when the edge is due
REMAINS = 5  # result: samples that were still to come at the edge; 0 before it
CONTROL = 6  # address at which BITS are set in the pin's CTRL
BITS = 7  # INVERT


@micropython.viper
def shoot(plan: ptr32) -> int:
    """Start sampling, and BEFORE ticks later invert a pin's interrupt input. The places of `plan`
    are numbers here, because viper looks up names slowly: 0 DMA, 1 WRITE, 2 COUNT, 3 ENABLE,
    4 REMAINS_AT, 5 REMAINS (the result), 6 CONTROL, 7 BITS."""
    dma = ptr32(plan[0])  # its registers: 1 write address, 2 words left, 7 count, which starts it
    dma[1] = plan[1]
    dma[7] = plan[2]
    ptr32(plan[3])[0] = 1 << 2  # enables the sampling machine, 6: number 2 of PIO 1
    while dma[2] > plan[4]:
        pass
    plan[5] = dma[2]
    ptr32(plan[6])[0] = plan[7]
    return 0


@micropython.viper
def address_of(memory: ptr32) -> int:
    """Return the address of an array."""
    return int(memory)


class ForcedEdge:
    """Forces an edge at a limit input at a random moment, from an interrupt, while all pins are
    sampled."""

    def __init__(self):
        self._plan = plan = array("i", [0] * 8)
        length = sampler.length
        plan[DMA] = 0x50000000 + 0x40 * sampler.dma.channel  # DMA's base; 0x40 bytes per channel
        plan[WRITE] = address_of(sampler.words)
        plan[COUNT] = length
        plan[ENABLE] = PIO1 + SET
        plan[REMAINS_AT] = length - BEFORE
        plan[BITS] = INVERT
        self._timer = Timer()
        self._interrupt = self._make_interrupt()

    def _make_interrupt(self):
        """Return a closure for the timer, because an interrupt must not look up global names."""
        kernel, plan = shoot, self._plan

        def interrupt(_timer):
            kernel(plan)

        return interrupt

    def fire(self, pin, collect):
        """Force one edge at a limit's pin, after 2 to 9 ms. collect: collect garbage meanwhile.
        Returns the tick of the edge in the samples, or None if the chip's STATUS does not show the
        forced interrupt."""
        status = PINS + 8 * pin  # CTRL is 4 bytes after it
        before = mem32[status] >> TO_PROCESSOR
        sampler.ready()
        self._plan[REMAINS] = 0
        self._plan[CONTROL] = status + 4 + SET
        self._timer.init(
            mode=Timer.ONE_SHOT,
            period=random_between(2000, 9000),
            tick_hz=1_000_000,
            callback=self._interrupt,
            hard=True,
        )
        while not self._plan[REMAINS]:  # until shoot() has run
            if collect:
                gc.collect()
        sampler.wait()
        is_forced = (mem32[status] >> TO_PROCESSOR ^ before) & 1
        mem32[status + 4 + CLEAR] = INVERT
        self._timer.deinit()
        return self._plan[COUNT] - self._plan[REMAINS] if is_forced else None


def ticks_to_last_edge(tick):
    """Return the ticks from that tick of the samples to the last edge of any STEP pin; -1 if there
    was none."""
    last = -1
    for pin in board.STEP:
        edges = sampler.edges(pin, tick)
        if len(edges) > 1:  # the first number is a level
            last = max(last, edges[-1] - tick)
    return last


def attach_listener(drive, port):
    """Make a limit switch the outputs off and stop the engine. Returns a list with one number,
    which counts the limits."""
    limit_count = [0]
    kill, stop = port.kill, drive.engine.stop

    class Listener:
        def on_limits(self):
            kill()
            stop()
            limit_count[0] += 1

        def on_controls(self, active):
            pass

        def on_fault(self):
            stop()

    port.attach(Listener())
    return limit_count


def check_stops(drive, port, limit_count, forced_edge):
    """Check each limit input in turn, first undisturbed, then during garbage collections: all axes
    run as fast as they can, and a limit is forced.

    Reported: ticks from each limit to the last step, -1 if there was none; missed, limits without
    an event; wrong, stops with a position other than the count; shown, whether the chip shows
    forced interrupts.
    """
    pins = [pin for pin in getattr(board, "LIMIT", ()) if pin is not None]
    watched = min(WATCHED, LAST - FIRST)  # the last machine samples
    for collect in (False, True):
        ticks, missed, wrong, shown = [], 0, 0, True
        for index in range(CONFIG["limits"] if pins else 0):
            drive.count(watched)
            limit_count[0] = 0
            port.enable_limits(True)
            port.revive()  # outputs work again after the last limit's kill()
            backward = random_between(0, (1 << AXES) - 1)  # a mask of axes
            # At the highest rate of pulses of 3 us; more steps than it can make until the limit.
            drive.plan_even(drive.engine.max_step_hz(3), 1 << 20, backward)
            drive.start()
            edge_tick = forced_edge.fire(pins[index % len(pins)], collect)
            if edge_tick is None:
                shown = False
                drive.stop()
                break
            missed += limit_count[0] == 0
            ticks.append(ticks_to_last_edge(edge_tick))
            drive.stop()
            wrong += drive.of_watched(drive.position()) != drive.counted()
        port.enable_limits(False)
        say(
            "limits",
            collecting=collect,
            inputs=len(pins),
            shown=shown,
            missed=missed,
            wrong=wrong,
            ticks=ticks,
            window=sampler.length - BEFORE,
        )


def measure_pwm(pin):
    """Return the edges at the pin, in a window of some periods: the first level (1: on), then the
    ticks at which it changes."""
    time.sleep_ms(CONFIG["pwm_settles_ms"])
    sampler.look()
    edges = sampler.edges(pin)
    edges[0] ^= "SPINDLE_PWM" in getattr(board, "INVERT", ())  # if the output is inverted
    return edges


def check_pwm(port, forced_edge):
    """Record the spindle's PWM at zero, half and full power, after a limit, and when commanded
    after a kill, which must have no effect."""
    pin = getattr(board, "SPINDLE_PWM", None)
    if pin is None or not CONFIG["pwm"]:
        say("pwm", asked=CONFIG["pwm"], wired=pin is not None)
        return
    full = getattr(board, "PWM_MAX", 1000)
    # Eight periods in all samples.
    sampler.hz = min(TICK_HZ, getattr(board, "PWM_HZ", 5000) * (sampler.length // 8))
    port.revive()
    for power in (0, full // 2, full):
        port.spindle(power > 0, power)
        say("pwm", power=power, full=full, edges=measure_pwm(pin))
    inputs = [limit for limit in getattr(board, "LIMIT", ()) if limit is not None]
    if inputs:
        port.enable_limits(True)
        edge_tick = forced_edge.fire(inputs[0], collect=False)
        port.enable_limits(False)
        say("pwm after a limit", shown=edge_tick is not None, edges=measure_pwm(pin))
    port.kill()
    port.spindle(True, full)
    say("pwm after a kill", edges=measure_pwm(pin))
    port.spindle(False, 0)


def check_limits(drive, port):
    """Run all checks of this file in turn."""
    drive.pulse(3)
    settle()
    limit_count = attach_listener(drive, port)
    forced_edge = ForcedEdge()
    check_stops(drive, port, limit_count, forced_edge)
    check_pwm(port, forced_edge)
    port.kill()
