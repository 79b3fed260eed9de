# mypy: disable-error-code=arg-type
"""Pins of an RP2040 or RP2350 other than STEP and DIR: limits, probe, controls, spindle, coolant.

Interrupts are hard: a handler runs at once, whatever the main loop does, and neither allocates nor
raises. Pins have a higher priority than all other interrupts, so that a limit switch acts also
while the pulse engine's interrupt runs. All inputs have pull-ups.
"""

import sys
import time
from array import array

import machine
import micropython
from machine import PWM, Timer
from micropython import const
from ports.input_pins import NOT_WIRED
from ports.port import PortPins

from pio.state_layout import RP2350

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

# The interrupt controller's table of priorities, a byte each.
_PRIORITIES = const(0xE000E400)  # address of the first interrupt's byte
_URGENT = const(0x40)  # a lower value comes first; MicroPython sets all to 0x80
_PINS_IRQ = const(13)  # number of the pins' interrupt, IO_IRQ_BANK0
_PINS_IRQ_2350 = const(21)  # the same of an RP2350

# The watchdog's control register.
_WATCHDOG = const(0x40058000)  # address
_WATCHDOG_2350 = const(0x400D8000)  # the same of an RP2350
_TO_CLEAR_BYTES = const(0x3000)  # from a register to its alias where ones clear bits
_WATCHDOG_ENABLE = const(1 << 30)  # bit

# A pad's control register. Its field OUTOVER says what comes out: 0 the output as it is, 2 low,
# 3 high.
_CONTROL = const(0x40016004)  # of pin 0, in the alias where ones set bits
_CONTROL_2350 = const(0x4002A004)  # the same of an RP2350
_CONTROL_STEP = const(8)  # bytes from one pin to the next
_TO_CLEAR_WORDS = const(0x400)  # words from that alias to the one where ones clear bits
_OUTOVER = const(8)  # first bit of OUTOVER
_OUTOVER_2350 = const(12)  # the same of an RP2350
_FORCED = const(2)  # value of OUTOVER for low; + 1 for high
_OUTOVER_BITS = const(3)  # mask of OUTOVER, before it is shifted
_GPIO_IN = const(0xD0000004)  # levels of pins 0 to 31
_LAST_COMMON_PIN = const(31)  # only an RP2350B has pins above
# Pins share a PWM slice if their numbers differ in no bit of this mask, except the lowest.
_SLICE_BITS = const(0x2F)  # the lowest bit is the channel in the slice
_SLICE_BITS_ABOVE = const(0x27)  # of pins above 31


class GpioPort(PortPins):
    """A Port on the pins of an RP2 chip."""

    def __init__(self, board: "ModuleType") -> None:
        enables = getattr(board, "ENABLE", None)
        super().__init__(board, (Timer(), Timer()), enables, has_hard=True)
        if RP2350:  # this build supports one: only that chip has pins above 31
            for number in self._input_numbers:
                if _LAST_COMMON_PIN < number < NOT_WIRED:
                    raise ValueError(
                        "pin %d: limits, probe, buttons must be on pins 0 to 31" % number
                    )
        # For kill(): 1 once it has run; then pairs, a register's address and bits; then 0.
        self._pads = array("i", [0, 0])
        self._all_bits = _OUTOVER_BITS << (_OUTOVER_2350 if _is_rp2350() else _OUTOVER)
        self._list_pads()
        _make_urgent()  # the pins' interrupt comes before all others

    def _list_pads(self) -> None:
        """Make the table _pads of kill(): for each output, the address of its pad's control
        register and the bits that force its level when off. _tools: (pin number, pin, level when
        off) of each output except the PWM.

        The PWM is first, so that kill() switches off the spindle or laser first. Element 0, the
        mark that kill() has run, keeps its value; the last 0 ends kill()'s loop.
        """
        control, shift = _CONTROL, _OUTOVER
        if _is_rp2350():
            control, shift = _CONTROL_2350, _OUTOVER_2350
        held = [(number, off_level) for number, _, off_level in self._tools]
        if self.pwm:
            held.insert(0, (self._pwm_number, self._pwm_off))
        pads = [self._pads[0]]
        for number, off_level in held:
            pads += [control + _CONTROL_STEP * number, (_FORCED | off_level) << shift]
        self._pads = array("i", pads + [0])

    @micropython.viper
    def kill(self) -> int:
        """Switch off spindle, laser, coolant, and outputs of extras, until revive().

        The pads are held at their level: what an interrupted set_power() still writes does not
        come out.
        """
        pads = ptr32(self._pads)  # see _list_pads()
        pads[0] = 1
        i = 1
        while pads[i]:
            control = ptr32(pads[i])
            control[0] = pads[i + 1]
            i += 2
        return 0

    def levels(self) -> int:
        """Return the active inputs as PortInputs.levels() does, a bit each, in the order of
        _input_numbers: from the register of all pins, so at one instant."""
        numbers = self._input_numbers
        # _control_invert: mask of inputs that are active at the high level. The address is a
        # signed integer of 32 bits.
        return _levels(_GPIO_IN - (1 << 32), numbers, len(numbers), self._control_invert)

    def revive(self) -> None:
        """Release what kill() has held. The outputs are off and can be set again."""
        if self._pads[0]:  # kill() has run
            self.safe()  # all off, before they are released
            for pwm in [self.pwm] + self._own_pwm:
                if pwm:  # a new duty cycle takes effect with the next pulse: wait for it
                    time.sleep_us(1_000_000 // pwm.freq() + 1)
            _release(self._pads, self._all_bits)

    def _begin_pulses(self, index: int, hz: int) -> PWM:
        """Start PWM of `hz` on an output of an extra, by its index, and return it. ValueError on a
        conflict: the two pins of a slice have one frequency, and two pins of the same channel of a
        slice have the same pulses. Pins share a slice if their numbers differ in no bit of
        slice_bits except the lowest, which is the channel."""
        own = self._own_numbers[index]
        others: "list[tuple[int | None, int]]" = list(zip(self._own_numbers, self._own_hz))
        slice_bits = _SLICE_BITS
        if RP2350:
            slice_bits = _SLICE_BITS_ABOVE if own > _LAST_COMMON_PIN else _SLICE_BITS
        if self.pwm:
            others.append((self._pwm_number, self.pwm.freq()))
        for number, its_hz in others:
            # Without pulses, without a pin, the pin itself, or in another slice.
            if not its_hz or number is None or number == own or (number ^ own) & slice_bits > 1:
                continue
            if its_hz != hz or (number ^ own) & 1 == 0:  # 0: the same channel
                raise ValueError(
                    "pin %d shares a PWM slice with pin %d: use the same frequency" % (own, number)
                )
        pwm = super()._begin_pulses(index, hz)
        if self._pads[0]:  # switching a pad to the PWM releases it
            self.kill()
        return pwm

    def rest(self, levels: int) -> None:
        """Set the levels that kill() gives to extras' outputs. levels: a bit per output, as
        PortPins.rest() has it."""
        super().rest(levels)
        self._list_pads()

    def watch(self, timeout_ms: int) -> "Callable[[], None] | None":
        """Start the watchdog: it resets the chip if the returned function is not called for
        timeout_ms. 0 stops the watchdog."""
        if timeout_ms:
            watchdog: "Callable[[], None]" = machine.WDT(timeout=timeout_ms).feed
            return watchdog
        # MicroPython cannot stop the watchdog; clearing its enable bit can.
        control = _WATCHDOG_2350 if _is_rp2350() else _WATCHDOG
        machine.mem32[control + _TO_CLEAR_BYTES] = _WATCHDOG_ENABLE
        return None


@micropython.viper
def _levels(gpio_in: ptr32, pins: ptr8, count: int, inverted: int) -> int:
    """Return the active inputs, a bit each: those at the low level; at the high level if their
    bit of `inverted` is set.

    gpio_in: the register of all pins' levels; pins: each input's pin number, of which NOT_WIRED
    counts as high; count: number of inputs.
    """
    levels = gpio_in[0]
    mask = 0
    for i in range(count):
        if pins[i] != NOT_WIRED and (levels >> pins[i]) & 1 == 0:
            mask |= 1 << i
    return mask ^ inverted


@micropython.viper
def _release(pads: ptr32, bits: int) -> int:
    """Clear `bits` in the control registers of all pads that kill() holds. Returns 0.

    pads: the table of _list_pads(): a mark, pairs of a register's address and bits, then 0.
    """
    pads[0] = 0  # kill() is no longer in effect
    i = 1
    while pads[i]:
        control = ptr32(pads[i])
        control[_TO_CLEAR_WORDS] = bits
        i += 2
    return 0


def _make_urgent() -> None:
    """Give the interrupt of pins a higher priority than all others have, in the interrupt
    controller's table."""
    number = _PINS_IRQ_2350 if _is_rp2350() else _PINS_IRQ
    address = _PRIORITIES + number // 4 * 4  # of the word with the interrupt's byte
    shift = number % 4 * 8
    others = machine.mem32[address] & ~(0xFF << shift)
    machine.mem32[address] = others | _URGENT << shift


def _is_rp2350() -> bool:
    """Return whether the chip is an RP2350."""
    return "RP2350" in sys.implementation._machine
