"""Spindle and laser: from a speed in rpm to power at the pin.

The interrupt sets power per segment while the machine moves (set_power);
everything else goes through turn(). Never waits: whoever changes the spindle
synchronises first (canon.py).
"""

from array import array

from base.f32 import f32
from micropython import const
from motion import layout

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from base.settings import Settings
    from base.state import State
    from interfaces import Port

OFF = const(0)
CW = const(0x10)
CCW = const(0x20)
_TURNING = const(0x30)

# Least power of a spindle that turns.
_MIN_POWER = const(1)


class Spindle:
    """One PWM spindle with a direction pin."""

    def __init__(self, port: "Port", state: "State", enable_by_direction: bool) -> None:
        self._port = port
        self._state = state
        # The direction's pin says that the spindle is on: M3 and M4 are the same then.
        self._has_enable = enable_by_direction
        self._power = 0
        self._direction = CW  # of the pin
        self._enabled = False
        # What power() was asked last, and what it said: most blocks ask the same again.
        self._asked_rpm = -1.0
        self._asked_override = 0
        self._answered_rpm = 0.0
        self._answered_power = 0
        self.laser = False
        self._reversed = False  # M4; in laser mode power follows the speed then

    def configure(self, settings: "Settings", table: "array[int]") -> None:
        """Take over $30, $31 and $32. table: the planner's, for the kernels."""
        self._asked_rpm = -1.0
        self._max_rpm = settings.max_rpm
        self._min_rpm = settings.min_rpm
        self.laser = bool(settings.laser_mode)
        span = f32(self._max_rpm - self._min_rpm)
        full = self._port.pwm_max
        self._gradient = f32((full - _MIN_POWER) / span) if span > 0 else 0.0
        table[layout.POWER_FLOOR] = int(self._min_rpm * self._gradient * 64)
        table[layout.POWER_MAX] = full

    def power(self, rpm: float) -> int:
        """Power for a programmed speed, override included; tells the state what speed that is."""
        state = self._state
        if rpm == self._asked_rpm and state.spindle_override == self._asked_override:
            state.spindle_rpm = self._answered_rpm
            return self._answered_power
        self._asked_rpm = rpm
        self._asked_override = state.spindle_override
        self._answered_power = self._work_out(rpm)
        self._answered_rpm = state.spindle_rpm
        return self._answered_power

    def _work_out(self, rpm: float) -> int:
        state = self._state
        rpm = f32(rpm * f32(f32(0.01) * state.spindle_override))
        full = self._port.pwm_max
        if self._min_rpm >= self._max_rpm or rpm >= self._max_rpm:
            state.spindle_rpm = self._max_rpm
            return full
        if rpm <= self._min_rpm:
            if rpm == 0:
                state.spindle_rpm = 0.0
                return 0
            state.spindle_rpm = self._min_rpm
            return _MIN_POWER
        state.spindle_rpm = rpm
        return int(f32(f32(rpm - self._min_rpm) * self._gradient)) + _MIN_POWER

    def block_power(self, flags: int, rpm: float) -> int:
        """What a planner block with these flags carries: see slice_kernel.power()."""
        if not flags & _TURNING:
            return 0
        if not flags & layout.DYNAMIC:
            return self.power(rpm)
        percent = self._state.spindle_override
        if percent != 100:
            rpm = rpm * percent / 100
        return int(min(rpm, self._max_rpm) * self._gradient * 64)

    def turn(self, direction: int, rpm: float) -> None:
        """Set direction and speed now. In laser mode a reversed spindle begins with no power."""
        self._reversed = direction == CCW
        if direction == OFF:
            self._state.spindle_rpm = 0.0
            self.stop()
        else:
            self._direction = CW if self._has_enable else direction
            self._enabled = True
            self._port.direction(1 if self._has_enable or direction == CCW else 0)
            if self.laser and self._reversed:
                rpm = 0.0
            self.set_power(self.power(rpm))
        self._state.override_countdown = 0

    def set_power(self, power: int) -> None:
        """Power of the segment that begins. Safe in an interrupt."""
        if power != self._power:
            self._power = power
            self._port.spindle(power != 0, power)

    def rest(self) -> None:
        """Motion has come to its end. A beam that follows the speed has none. Interrupt."""
        if self._reversed and self.laser:
            self.set_power(0)

    def stop(self) -> None:
        """Off, at once; safe in an interrupt."""
        self._power = 0
        self._port.spindle(False, 0)
        if self._has_enable:
            self._enabled = False
            self._port.direction(0)

    def direction(self) -> int:
        """OFF, CW or CCW: what the pins say."""
        on = self._enabled if self._has_enable else self._power
        return self._direction if on else OFF
