"""Pins of the simulated machine: outputs to read, inputs to push, switches that close."""

from base.controls import EMERGENCY_STOP, LIMITS_AT, PROBE_AT

from . import motor_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

    from interfaces import InputListener

    from .seams import Clock

# Names of the inputs in recordings, in the bit order of Port.controls().
CONTROLS = ("reset", "hold", "start")
ESTOP = "estop"
# On an Uno with a safety door, the door replaces the hold button.
CONTROLS_WITH_DOOR = ("reset", "", "start", "hold")


def limit_names(board: "ModuleType") -> "tuple[str, ...]":
    """Return the limit inputs' names in recordings, in the bit order of Port.limits(), a bit per
    motor: limit_x, and limit_y2 for a second motor; "" if a second motor has none."""
    names = ["limit_" + name.lower() for name in motor_names.names(motor_names.letters(board))]
    wired = getattr(board, "LIMIT", ())
    for motor in range(motor_names.axes_of(board), len(names)):  # the second motors
        if motor >= len(wired) or wired[motor] is None:
            names[motor] = ""
    return tuple(names)


def shared_inputs(board: "ModuleType") -> "list[int]":
    """Return masks of limit inputs that share one pin."""
    wired = getattr(board, "LIMIT", ())
    masks: "dict[int, int]" = {}  # by pin
    for bit, pin in enumerate(wired):
        if pin is not None:
            masks[pin] = masks.get(pin, 0) | 1 << bit
    return list(masks.values())


class SimPwm:
    """The frequency of its spindle's output."""

    def __init__(self, hz: int) -> None:
        self._hz = hz

    def freq(self, hz: int = 0) -> int:
        self._hz = hz or self._hz
        return self._hz


class SimPort:
    """A Port whose pins are attributes. Closed means pulled to ground."""

    def __init__(self, rig: "Clock", board: "ModuleType") -> None:
        self.pwm_max = getattr(board, "PWM_MAX", 1000)
        self.pwm = SimPwm(getattr(board, "PWM_HZ", 5000))
        self.limit_names = limit_names(board)
        self._shared = shared_inputs(board)
        self._controls = CONTROLS_WITH_DOOR if getattr(board, "SAFETY_DOOR", False) else CONTROLS
        # The board's direction pin signals that the spindle is on, so safe() clears it.
        self._dir_is_enable: bool = getattr(board, "SPINDLE_ENABLE_PIN", False)
        self.enable_pin = 1
        self.spindle_on = False
        self.spindle_pwm = 0
        self.spindle_dir = 0
        self.flood = 0
        self.mist = 0
        self._rig = rig
        self._pushed: "dict[str, bool]" = {}  # by hand: whether closed, by name
        self._closed: "set[str]" = set()  # names, by hand or by a switch
        self._listener: "InputListener | None" = None
        self.after_controls: "Callable[[int], object] | None" = None
        self._on_contact: "Callable[[], None] | None" = None
        self._contact_level = True  # the probe's level that ends the motion
        self._limits_enabled = False
        self._killed = False  # outputs stay off until revive()
        # Pins of an extra.
        self.own_outputs = 0  # mask of their levels
        self._safe_outputs = 0  # the mask for safe() and kill()
        self.own_pulses: "dict[int, tuple[int, int]]" = {}  # Hz and duty, by output
        self._own_inputs: "tuple[str, ...]" = ()  # names as for push()
        self._on_change: "Callable[[], None] | None" = None
        self.limit_invert = 0
        self.fault = ""
        self.estop: "Callable[[], bool] | None" = None
        if getattr(board, "ESTOP", None) is not None:
            self.estop = self._stop_is_open
            # Not pressed: its contact opens when pressed, or when its wire breaks.
            self._pushed[ESTOP] = True
            self._closed.add(ESTOP)

    # The Port interface

    def attach(self, listener: "InputListener") -> None:
        self._listener = listener

    def enable_limits(self, on: bool) -> None:
        self._limits_enabled = on

    def kill(self) -> None:
        self._killed = True
        self.safe()

    def revive(self) -> None:
        if self._killed:
            self.safe()
            self._killed = False

    def safe(self) -> None:
        """Switch spindle, coolant and an extra's outputs off."""
        self.spindle_on = False
        self.spindle_pwm = self.flood = self.mist = 0
        self.own_outputs = self._safe_outputs
        self.own_pulses.clear()
        if self._dir_is_enable:
            self.spindle_dir = 0

    def watch_probe(self, on_contact: "Callable[[], None] | None", closed: bool) -> None:
        """Call on_contact once, when the probe has that level or at once if it has; None: stop
        watching."""
        self._on_contact = on_contact
        self._contact_level = closed
        self._look_at_probe()

    def limits(self) -> int:
        """Return a mask of the closed limit inputs, by motor."""
        closed = self._mask(self.limit_names)
        for inputs_of_pin in self._shared:
            if closed & inputs_of_pin:
                closed |= inputs_of_pin
        return closed

    def controls(self) -> int:
        return self._mask(self._controls)

    def probe(self) -> bool:
        return "probe" in self._closed

    def levels(self) -> int:
        return self.controls() | self.probe() << PROBE_AT | self.limits() << LIMITS_AT

    def enable(self, level: int) -> None:
        self.enable_pin = level

    def direction(self, level: int) -> None:
        self.spindle_dir = level
        if self._killed:
            self.safe()

    def spindle(self, on: bool, power: int) -> None:
        self.spindle_on = on
        self.spindle_pwm = power
        if self._killed:
            self.safe()

    def coolant(self, mask: int) -> None:
        self.flood = mask & 1
        self.mist = mask >> 1 & 1
        if self._killed:
            self.safe()

    def add_pins(self, outputs: "tuple[int, ...]", inputs: "tuple[int, ...]") -> None:
        self._own_inputs = tuple(["pin_%d" % pin for pin in inputs])

    def drive(self, levels: int) -> None:
        self.own_outputs = levels
        if self._killed:
            self.safe()

    def pulse(self, index: int, hz: int, duty: int) -> None:
        """Set the frequency and duty of an extra's output; its level shows whether duty is not
        0."""
        self.own_pulses[index] = hz, duty
        bit = 1 << index
        self.own_outputs = self.own_outputs | bit if duty else self.own_outputs & ~bit
        if self._killed:
            self.safe()

    def rest(self, levels: int) -> None:
        """Set the levels that safe() gives an extra's outputs."""
        self._safe_outputs = levels

    def sense(self) -> int:
        """Return the levels of an extra's inputs: 1 while open, because of their pull-ups."""
        all_open = (1 << len(self._own_inputs)) - 1
        return all_open ^ self._mask(self._own_inputs)

    def watch_pins(self, on_change: "Callable[[], None]") -> None:
        self._on_change = on_change

    def ticks_ms(self) -> int:
        return int(self._rig.now // self._rig.ticks_per_ms)

    def elapsed_ms(self, since: int) -> int:
        return self.ticks_ms() - since

    # Interface for the simulator

    def power_off(self) -> None:
        """Switch the chip off: outputs float, and no listener remains."""
        self._listener = self._on_contact = None
        self.enable_pin = 1
        self.spindle_on = False
        self.spindle_pwm = self.spindle_dir = self.flood = self.mist = 0

    def push(self, pins: "dict[str, bool]") -> None:
        """Close (True) or open inputs by name, all at once, as by hand: they stay so. A switch may
        close them as well."""
        self._pushed.update(pins)
        self.update()

    def is_closed(self, pin: str) -> bool:
        """Return whether the firmware would see the input closed now."""
        return pin in self._closed

    def awaits_probe(self) -> "bool | None":
        """Return the level at which the probe stops motion; None if no probing is active."""
        return self._contact_level if self._on_contact else None

    def update(self) -> None:
        """Read every switch at the motors' present steps, and call the listeners of the inputs
        that have changed."""
        engine = self._rig.engine
        steps = self._rig.scratch
        engine.physical(steps)
        closed = {name for name, is_closed in self._pushed.items() if is_closed}
        for switch in engine.switches:
            if switch.closed(steps[switch.axis]):
                closed.add(switch.pin)
        changed = closed ^ self._closed
        self._closed = closed
        if "probe" in changed:
            self._look_at_probe()
        if self._on_change and any(name in changed for name in self._own_inputs):
            self._on_change()
        if (
            self._listener
            and self._limits_enabled
            and any(name in changed for name in self.limit_names)
        ):
            self._listener.on_limits()
        has_button = any(name in changed for name in self._controls)
        if self._listener and (has_button or ESTOP in changed):
            stop = EMERGENCY_STOP if self.estop and self.estop() else 0
            self._listener.on_controls(self.controls() | stop)
            if self.after_controls:
                self.after_controls(self.controls() | stop)

    def _stop_is_open(self) -> bool:
        """Return whether the emergency stop is pressed, or its wire broken."""
        return ESTOP not in self._closed

    def _look_at_probe(self) -> None:
        """Report the contact, once, if the probe has the level that ends the motion."""
        if self._on_contact and self.probe() == self._contact_level:
            on_contact = self._on_contact
            self._on_contact = None  # first, because the call may start to watch again
            on_contact()

    def _mask(self, names: "tuple[str, ...]") -> int:
        """Return a mask of the inputs that are closed, in the order of the names."""
        mask = 0
        for bit, name in enumerate(names):
            if name in self._closed:
                mask |= 1 << bit
        return mask
