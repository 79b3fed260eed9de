# mypy: disable-error-code=arg-type
"""Spindle and laser: from a speed in rpm to power at the pin.

During motion the interrupt sets power per segment (set_power); everything else calls set_speed().
Nothing here waits: the caller must synchronise before it changes the spindle (canon.py).
"""

import micropython
from base.float32 import copy, f32
from base.float32_math import add_single, multiply
from base.state import OVERRIDE_PART, RPM
from micropython import const
from motion import layout

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array

    from base.settings import Settings
    from base.state import State
    from interfaces import Port

OFF = const(0)
CW = const(0x10)
CCW = const(0x20)
_TURNING_FLAGS = const(0x30)  # CW | CCW

_MIN_POWER = const(1)  # of a turning spindle

# Indices into State.spindle, floats. Those of base/state.py: RPM, the speed after override and
# limits, and OVERRIDE_PART, the override as a fraction. More of them:
ASKED = const(0)  # the programmed rpm, from which power is computed
HIGHEST = const(3)  # $30, rpm
_LOWEST = const(4)  # $31, rpm
_MINUS_LOWEST = const(5)  # -$31
_FULL_POWER = const(6)  # in PWM steps; this one is stored as an integer
_GRADIENT = const(7)  # power per rpm above $31
_FINE_GRADIENT = const(8)  # the same in 1/64 of a PWM step
LASER = const(9)  # 0: not a laser
_ONE = const(0x3F800000)  # the bits of the float 1.0
_FINE_PER_POWER = const(64)  # so many in a PWM step
_STEEPEST = 8388608.0  # 2**23; power at $30 is less, because 64 times it must have 30 bits


@micropython.viper
def power_from_rpm(scale: ptr32, flags: int) -> int:
    """Return the spindle power of a planner block with these flags, in PWM steps; with DYNAMIC, a
    laser in M4, in 1/64 of one, to be scaled by the speed (slice_kernel.scaled_power()).

    scale: State.spindle, floats as bits; those that are not negative compare as integers do.
    scale[ASKED] holds the programmed rpm; here it becomes rpm with the override, then power.
    scale[RPM] becomes the speed to report: 0 with DYNAMIC. Power is 1 + (rpm - $31) * gradient,
    from 1 to full power, and 0 for 0 rpm; with DYNAMIC it is rpm * gradient in 1/64, rpm at most
    $30.
    """
    if not flags & _TURNING_FLAGS:
        return 0
    if scale[OVERRIDE_PART] != _ONE:
        multiply(scale, ASKED, scale, OVERRIDE_PART)
    rpm = scale[ASKED]
    highest = scale[HIGHEST]
    least = 0  # power at $31
    if flags & layout.DYNAMIC:
        scale[RPM] = 0
        if rpm > highest:
            scale[ASKED] = highest
        multiply(scale, ASKED, scale, _FINE_GRADIENT)
    else:
        lowest = scale[_LOWEST]
        if rpm == 0 and scale[LASER]:  # dark, also with $30=0 or $31 above $30
            scale[RPM] = 0
            return 0
        if rpm >= highest or lowest >= highest:
            scale[RPM] = highest
            return scale[_FULL_POWER]  # a whole number
        if rpm <= lowest:
            scale[RPM] = lowest if rpm > 0 else 0
            return _MIN_POWER if rpm > 0 else 0
        scale[RPM] = rpm
        add_single(scale, _MINUS_LOWEST, scale, ASKED)
        multiply(scale, ASKED, scale, _GRADIENT)
        least = _MIN_POWER
    power = scale[ASKED]
    # The float's whole part: a mantissa of 24 bits has the exponent 150.
    shift = 150 - (power >> 23)
    mantissa = (power & 0x7FFFFF) | 0x800000
    if shift < 0:  # 2**24 or more: only with DYNAMIC, without `least`
        return mantissa << (0 - shift)
    return least + (mantissa >> shift if shift < 25 else 0)


def in_range(scale: "array[float]", rpm: float) -> float:
    """Return the speed that a programmed rpm results in: with the override, limited to $31 to $30;
    0 stays 0. As in Grbl, $30 for every speed if $31 is not below it. scale: State.spindle."""
    rpm = f32(rpm * scale[OVERRIDE_PART])
    highest, lowest = scale[HIGHEST], scale[_LOWEST]
    if rpm >= highest or lowest >= highest:
        return highest
    return rpm if rpm > lowest or rpm <= 0 else lowest


class Spindle:
    """One PWM spindle with a direction pin.

    enable_by_direction: that pin is an enable pin instead (_has_enable); M3 and M4 are then the
    same. laser: laser mode ($32). _power: in PWM steps. _direction: CW or CCW, of the pin;
    _enabled: an enable pin is set. _reversed: M4; in laser mode power then follows the speed.
    """

    def __init__(self, port: "Port", state: "State", enable_by_direction: bool) -> None:
        self._port = port
        self._state = state
        self._has_enable = enable_by_direction
        self._power = 0
        self._direction = CW
        self._enabled = False
        self.laser = False
        self._reversed = False

    def configure(self, settings: "Settings", table: "array[int]") -> None:
        """Apply $30, $31 and $32. table: the planner's, for the kernels.

        Speeds are in rpm. Power is in steps of the PWM, 1 to pwm_max; where it follows the speed,
        in 1/64 of one (_FINE_GRADIENT, POWER_FLOOR).
        """
        self.laser = bool(settings.laser_mode)
        scale, full = self._state.spindle, self._port.pwm_max
        scale[LASER] = self.laser
        span = f32(settings.max_rpm - settings.min_rpm)
        gradient = f32((full - _MIN_POWER) / span) if span > 0 else 0.0
        if not 0 < settings.max_rpm * gradient < _STEEPEST:
            gradient = 0.0  # $30 and $31 are practically equal, or beyond single precision
        scale[HIGHEST] = settings.max_rpm
        scale[_LOWEST] = settings.min_rpm
        scale[_MINUS_LOWEST] = -settings.min_rpm
        scale[_GRADIENT] = gradient
        scale[_FINE_GRADIENT] = gradient * _FINE_PER_POWER
        # Up to this power at the full rate, a DYNAMIC block has _MIN_POWER at any speed.
        table[layout.POWER_FLOOR] = (
            int(settings.min_rpm * gradient * _FINE_PER_POWER) if gradient else 0
        )
        table[layout.POWER_MAX] = full
        # Copies the integer POWER_MAX, as its bits, to the array of floats: see power_from_rpm().
        copy(memoryview(table)[layout.POWER_MAX :], memoryview(scale)[_FULL_POWER:], 1)

    def power(self, rpm: float) -> int:
        """Return the power in PWM steps for a programmed rpm, with override and limits; sets the
        speed that is reported."""
        return self.block_power(CW, rpm)

    def block_power(self, flags: int, rpm: float) -> int:
        """Return the power of a planner block with these flags and programmed rpm, and set the
        speed that is reported: see power_from_rpm()."""
        scale = self._state.spindle
        scale[ASKED] = rpm
        return power_from_rpm(scale, flags)

    def set_speed(self, direction: int, rpm: float) -> None:
        """Set direction (OFF, CW or CCW) and programmed speed at once; the next status report
        shows it. In laser mode M4 starts without power."""
        if direction == OFF:
            self._reversed = False
            self._state.spindle[RPM] = 0.0
            self.stop()
        else:
            self.restore(direction, rpm)
        self._state.override_countdown = 0

    def restore(self, direction: int, rpm: float) -> None:
        """Switch on: direction is CW or CCW. For the end of a hold, or an override: unlike after
        set_speed(), the next status report does not show it, as in Grbl."""
        self.enable(direction)
        if self.laser and self._reversed:
            rpm = 0.0
        self.set_power(self.power(rpm))

    def enable(self, direction: int) -> None:
        """Set direction, CW or CCW, or the enable pin; power is set elsewhere."""
        self._reversed = direction == CCW
        self._direction = CW if self._has_enable else direction
        self._enabled = True
        # The pin: 1 for CCW; 1 for either, if it is the enable pin.
        self._port.direction(1 if self._has_enable or direction == CCW else 0)

    def set_power(self, power: int) -> None:
        """Set the power, in PWM steps; the engine calls it as a segment begins. Safe in an
        interrupt."""
        if power != self._power:
            self._power = power
            self._port.spindle(power != 0, power)

    def on_motion_end(self) -> None:
        """Switch off a beam whose power follows the speed, because motion has ended. Interrupt."""
        if self._reversed and self.laser:
            self.set_power(0)

    def stop(self) -> None:
        """Switch off at once; safe in an interrupt."""
        self._power = 0
        self._port.spindle(False, 0)
        if self._has_enable:
            self._enabled = False
            self._port.direction(0)

    def is_on(self) -> bool:
        """Return whether the tool turns or shines, by its report and by its pins."""
        return self._state.spindle[RPM] > 0 and self.direction() != OFF

    def direction(self) -> int:
        """Return OFF, CW or CCW, from the pins' state."""
        # Without an enable pin, a spindle without power is off.
        on = self._enabled if self._has_enable else self._power
        return self._direction if on else OFF
