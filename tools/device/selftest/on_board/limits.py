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

# Places in the argument of shoot().
DMA, WRITE, COUNT, ENABLE, REMAINS_AT, REMAINS, CONTROL, BITS = 0, 1, 2, 3, 4, 5, 6, 7


@micropython.viper
def shoot(plan: ptr32) -> int:
    """Start sampling, and BEFORE ticks later invert a pin's interrupt. Stores in REMAINS how many
    samples the DMA had left then. plan: by the places above, which are numbers here for viper."""
    dma = ptr32(plan[0])  # its registers: 1 write address, 2 words left, 7 count, which starts it
    dma[1] = plan[1]
    dma[7] = plan[2]
    ptr32(plan[3])[0] = 1 << 2  # enables the sampling machine
    while dma[2] > plan[4]:
        pass
    plan[5] = dma[2]
    ptr32(plan[6])[0] = plan[7]
    return 0


@micropython.viper
def address_of(memory: ptr32) -> int:
    """Return the address of an array."""
    return int(memory)


class Shot:
    """Forces an edge at a limit input at a random moment, from an interrupt, while all pins are
    sampled."""

    def __init__(self):
        self._plan = plan = array("i", [0] * 8)
        length = sampler.length
        plan[DMA] = 0x50000000 + 0x40 * sampler.dma.channel
        plan[WRITE] = address_of(sampler.words)
        plan[COUNT] = length
        plan[ENABLE] = PIO1 + SET
        plan[REMAINS_AT] = length - BEFORE
        plan[BITS] = INVERT
        self._timer = Timer()
        self._act = self._make()

    def _make(self):
        """Return a closure for the timer, because an interrupt must not look up names."""
        act, plan = shoot, self._plan

        def interrupt(_timer):
            act(plan)

        return interrupt

    def fire(self, pin, collect):
        """Force one edge. Returns its tick, or None if the chip does not show the forced
        interrupt."""
        status = PINS + 8 * pin
        before = mem32[status] >> TO_PROCESSOR
        sampler.ready()
        self._plan[REMAINS] = 0
        self._plan[CONTROL] = status + 4 + SET
        self._timer.init(
            mode=Timer.ONE_SHOT,
            period=random_between(2000, 9000),
            tick_hz=1_000_000,
            callback=self._act,
            hard=True,
        )
        while not self._plan[REMAINS]:
            if collect:
                gc.collect()
        sampler.wait()
        is_forced = (mem32[status] >> TO_PROCESSOR ^ before) & 1
        mem32[status + 4 + CLEAR] = INVERT
        self._timer.deinit()
        return self._plan[COUNT] - self._plan[REMAINS] if is_forced else None


def last_edge(at):
    """Return the ticks from `at` to the last edge of any axis; -1 if there was none."""
    last = -1
    for pin in board.STEP:
        edges = sampler.edges(pin, at)
        if len(edges) > 1:
            last = max(last, edges[-1] - at)
    return last


def hear(drive, port):
    """Make limits switch off and stop. Returns a list with the number of limit events."""
    heard = [0]
    kill, stop = port.kill, drive.engine.stop

    class Listener:
        def on_limits(self):
            kill()
            stop()
            heard[0] += 1

        def on_controls(self, active):
            pass

        def on_fault(self):
            stop()

    port.attach(Listener())
    return heard


def limits_stop(drive, port, heard, shot):
    """Check each limit input in turn, first undisturbed, then during garbage collections."""
    pins = [pin for pin in getattr(board, "LIMIT", ()) if pin is not None]
    watched = min(WATCHED, LAST - FIRST)  # the last machine samples
    for collect in (False, True):
        ticks, missed, wrong, shown = [], 0, 0, True
        for index in range(CONFIG["limits"] if pins else 0):
            drive.count(watched)
            heard[0] = 0
            port.enable_limits(True)
            port.revive()
            drive.even(drive.engine.max_step_hz(3), 1 << 20, random_between(0, (1 << AXES) - 1))
            drive.start()
            at = shot.fire(pins[index % len(pins)], collect)
            if at is None:
                shown = False
                drive.stop()
                break
            missed += heard[0] == 0
            ticks.append(last_edge(at))
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
    """Return level and edges at the pin, in a window of some periods."""
    time.sleep_ms(CONFIG["pwm_settles_ms"])
    sampler.look()
    edges = sampler.edges(pin)
    edges[0] ^= "SPINDLE_PWM" in getattr(board, "INVERT", ())
    return edges


def check_pwm(port, shot):
    """Record the PWM at zero, half and full power, after a limit, and when commanded after a
    kill."""
    pin = getattr(board, "SPINDLE_PWM", None)
    if pin is None or not CONFIG["pwm"]:
        say("pwm", asked=CONFIG["pwm"], wired=pin is not None)
        return
    full = getattr(board, "PWM_MAX", 1000)
    sampler.hz = min(TICK_HZ, getattr(board, "PWM_HZ", 5000) * (sampler.length // 8))
    port.revive()
    for power in (0, full // 2, full):
        port.spindle(power > 0, power)
        say("pwm", power=power, full=full, edges=measure_pwm(pin))
    inputs = [limit for limit in getattr(board, "LIMIT", ()) if limit is not None]
    if inputs:
        port.enable_limits(True)
        at = shot.fire(inputs[0], False)
        port.enable_limits(False)
        say("pwm after a limit", shown=at is not None, edges=measure_pwm(pin))
    port.kill()
    port.spindle(True, full)
    say("pwm after a kill", edges=measure_pwm(pin))
    port.spindle(False, 0)


def check_limits(drive, port):
    """Run all checks of this file in turn."""
    drive.pulse(3)
    settle()
    heard = hear(drive, port)
    shot = Shot()
    limits_stop(drive, port, heard, shot)
    check_pwm(port, shot)
    port.kill()
