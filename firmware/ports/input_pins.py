"""Inputs of a board, as far as all chips share them, and the callbacks for their changes.

An input is closed when pulled to ground; an input that is not wired (None in the board file) is
never closed. The callbacks, which run in an interrupt, neither allocate nor raise; if one raises
all the same, the tool goes off and motion stops. Every interrupt of a pin disarms that pin. A
timer arms it again some milliseconds later and reads it then, so that interference on any pin
starves neither engine nor main loop.
"""

import micropython
from base.controls import EMERGENCY_STOP, PROBE_AT
from machine import Pin, Timer
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from types import ModuleType

    from interfaces import InputListener

_BOTH_EDGES = Pin.IRQ_RISING | Pin.IRQ_FALLING
NOT_WIRED = const(255)  # in place of a pin's number
_DISARMED_MS = const(2)  # after an interrupt, unless the board file says otherwise
# Contacts bounce, and the position of the first touch that lasts must be exact to the step: so the
# probe is disarmed only after several edges.
_MOST_MISSES = const(4)  # edges of the probe that were over before the pin was read

_FAILED = "A pin's callback has failed"
_FAILED_TWICE = "A pin's callback failed, and so did the stop after it: cut the power"


class PortInputs:
    """The inputs of a Port.

    timers: two that nothing else uses. has_hard: interrupts can be hard. A list of pins has None
    for an input that is not wired. _hard: as has_hard. _limits_seen, _controls_seen: masks
    reported last. _limits_disarmed, _sensors_disarmed: some of these pins are disarmed until the
    look timer reads them; _look_timer_runs. _is_settling: a button has changed and may bounce; the
    control timer is running. _contact_level: what probe() returns at the contact waited for, at
    which _on_contact is called. _misses: edges of the probe that were over when it was read.
    _buttons: control inputs and emergency stop. _sensors: inputs of an extra; _on_sensor: called
    when one changes.
    """

    _sensors: "list[Pin | None]"

    kill: "Callable[[], object]"  # switches tools off until revive(); PortPins has it

    def __init__(self, board: "ModuleType", timers: "tuple[Timer, Timer]", has_hard: bool) -> None:
        self._hard = has_hard
        self._look_timer, self._control_timer = timers
        self._make_inputs(board)
        self.fault = ""  # the fault of the inputs, as text
        self.limit_invert = 0
        self._limits_enabled = False
        self._limits_seen = 0
        self._limits_disarmed = self._sensors_disarmed = False
        self._look_timer_runs = False
        self._is_settling = False
        self._controls_seen = 0
        self._on_contact: "Callable[[], None] | None" = None
        self._contact_level = True
        self._misses = 0
        # A bound method allocates each time it is taken: take it once.
        self._on_look_timer = self._look_at_inputs
        self._on_settle_timer = self._end_settling

    def _make_inputs(self, board: "ModuleType") -> None:
        """Make the pins that the board file names, and read its other options of inputs. _inputs
        has all pins in the order of the bits of levels(), _input_numbers the numbers of these."""
        option = board.__dict__.get  # getattr() would intern the names for good
        self._without_pull: "tuple[int, ...]" = option("NO_PULL_UP", ())
        self._limits = [self._make_input(pin) for pin in option("LIMIT", ())]
        self._limit_debounce_ms: int = option("LIMIT_DEBOUNCE_MS", 0)
        self._controls = [self._make_input(pin) for pin in option("CONTROL", ())]
        self._control_invert: int = option("CONTROL_INVERT", 0)
        self._debounce_ms: int = option("CONTROL_DEBOUNCE_MS", 0)
        self._estop = self._make_input(option("ESTOP", None))
        self.after_controls: "Callable[[int], object] | None" = None  # of extras (api.py)
        self.estop: "Callable[[], bool] | None" = self._is_open if self._estop else None
        self._buttons = list(self._controls)
        self._buttons.append(self._estop)
        self._probe = self._make_input(option("PROBE", None))
        unused = [None] * (PROBE_AT - len(self._controls))  # bits of levels() below the probe's
        self._inputs = self._controls + unused + [self._probe] + self._limits
        numbers = list(option("CONTROL", ())) + unused + [option("PROBE", None)]
        numbers += option("LIMIT", ())
        self._input_numbers = bytes(NOT_WIRED if n is None else n for n in numbers)

    def _make_input(self, pin: "int | None") -> "Pin | None":
        """Return an input, with pull-up unless the board file excludes it; None of None."""
        if pin is None:
            return None
        if pin in self._without_pull:
            return Pin(pin, Pin.IN)
        return Pin(pin, Pin.IN, Pin.PULL_UP)

    # Interrupts

    def attach(self, listener: "InputListener") -> None:
        """Set the listener: its callbacks are called in an interrupt when a limit, a control input
        or the emergency stop changes, or if a callback has failed. on_controls is passed a mask,
        which includes the emergency stop. Limits and probe stay disarmed until they are needed."""
        self._listener = listener
        self._enable_interrupts(self._limits, self._limit_changed)
        self._enable_interrupts((self._probe,), self._probe_changed)
        self._enable_interrupts(self._buttons, self._control_changed)
        _arm(self._buttons, _BOTH_EDGES)

    def _enable_interrupts(
        self, pins: "Iterable[Pin | None]", changed: "Callable[[Pin], object]"
    ) -> None:
        """Set the function that the pins' interrupts call; _arm() enables them."""
        for pin in pins:
            if pin and self._hard:
                pin.irq(changed, 0, hard=True)
            elif pin:
                pin.irq(changed, 0)

    def _fail(self) -> None:
        """Handle a callback that has raised: switch the tool off and notify the listener, which
        stops motion."""
        self.fault = _FAILED
        try:
            self.kill()
            self._listener.on_fault()
            self._limits_disarmed = True  # the look timer arms them again
            self._start_look_timer(0)
            self._start_settling()  # its end arms the buttons again
        except BaseException:
            self.fault = _FAILED_TWICE

    def _start_look_timer(self, ms: int) -> None:
        """Let the look timer read disarmed inputs in `ms` milliseconds. 0: in _DISARMED_MS or, if
        it runs already, when it is due: restarted at every edge, it failed after a while on a Pico
        whose main loop hung (emulated)."""
        if ms or not self._look_timer_runs:
            self._look_timer_runs = True
            # Periodic until the callback ends it, because a call may get lost. Not in a function
            # of its own: the stack is short here.
            self._look_timer.init(
                mode=Timer.PERIODIC,
                period=ms or _DISARMED_MS,
                callback=self._on_look_timer,
                hard=self._hard,
            )

    def _look_at_inputs(self, timer: "Timer") -> None:
        """Look timer's callback: arm disarmed inputs again, and report those that have changed.
        Each is armed before it is read, so that no change is missed. Interrupt."""
        try:
            timer.deinit()
            self._look_timer_runs = False
            if self._limits_disarmed:
                self._limits_disarmed = False
                self._look_at_limits()
            if self._misses:
                self._misses = 0
                self._arm_probe()
                self._look_at_probe()
            if self._sensors_disarmed:
                self._sensors_disarmed = False
                _arm(self._sensors, _BOTH_EDGES)
                self._on_sensor()
        except BaseException:
            self._fail()

    # Limits

    def enable_limits(self, on: bool) -> None:
        """Call the listener's on_limits when a limit input changes from now on, or ignore the
        limit inputs ($21)."""
        self._limits_enabled = on
        self._limits_seen = self.limits()
        _arm(self._limits, _BOTH_EDGES if on else 0)

    # Native code needs half the stack that bytecode does, on top of the main loop's and the
    # engine's.

    @micropython.native
    def _limit_changed(self, pin: "Pin") -> None:
        """Report a changed limit at once or, with a debounce time, let the timer report it. The
        pin stays disarmed until the timer reads it. Interrupt."""
        try:
            pin.irq().trigger(0)  # disarm it
            if not self._limit_debounce_ms:
                self._listener.on_limits()
                self._limits_seen = self.limits()
            self._limits_disarmed = True
            self._start_look_timer(self._limit_debounce_ms)
        except BaseException:
            self._fail()

    def _look_at_limits(self) -> None:
        """Arm the limits again, and report them if one has changed since they were reported last.

        With a debounce time they are reported instead if one is active now: a shorter pulse was
        interference. limit_invert: the levels while none is active.
        """
        if not self._limits_enabled:
            return
        _arm(self._limits, _BOTH_EDGES)
        now = self.limits()
        nothing_new = self.limit_invert if self._limit_debounce_ms else self._limits_seen
        if now != nothing_new:
            self._limits_seen = now
            self._listener.on_limits()

    def limits(self) -> int:
        """Return the mask of limit inputs pulled to ground, bit 0 = X, before $5 inverts it."""
        return _mask(self._limits)

    # Control inputs

    @micropython.native
    def _control_changed(self, pin: "Pin") -> None:
        """Report a changed control input at once. With a debounce time, further changes except the
        emergency stop's are then ignored until _end_settling(). Interrupt."""
        try:
            pin.irq().trigger(0)  # disarm it
            if self._is_settling and self._debounce_ms and pin is not self._estop:
                return  # a bounce
            active = self._mask_if_active(pin)
            self._controls_seen |= active  # also if the listener fails
            self._listener.on_controls(active)  # before the other inputs are read
            if self.after_controls:
                self.after_controls(active)
            self._controls_seen = self.controls()
            if not self._is_settling:
                self._start_settling()
        except BaseException:
            self._fail()

    @micropython.native
    def _mask_if_active(self, pin: "Pin") -> int:
        """Return the mask of this control input or emergency stop alone, 0 if it is not active."""
        if pin is self._estop:
            return EMERGENCY_STOP if pin.value() else 0  # its contact opens when pressed
        bit = 1 << self._controls.index(pin)
        closed = 0 if pin.value() else bit
        return closed ^ (self._control_invert & bit)

    def _start_settling(self) -> None:
        """Let the control timer call _end_settling() after the debounce time, or _DISARMED_MS."""
        self._is_settling = True
        self._control_timer.init(
            mode=Timer.PERIODIC,
            period=self._debounce_ms or _DISARMED_MS,
            callback=self._on_settle_timer,
            hard=self._hard,
        )

    def _end_settling(self, timer: "Timer") -> None:
        """Control timer's callback: arm the control inputs again; if they have changed meanwhile,
        report them and wait again. An emergency stop that is still pressed is reported again."""
        try:
            timer.deinit()
            self._is_settling = False
            _arm(self._buttons, _BOTH_EDGES)  # before the pins are read: no change is missed
            changed = self._controls_seen != self.controls()
            self._controls_seen = self.controls()
            if changed or (self._estop and self._estop.value()):
                self._listener.on_controls(self._active())
                if self.after_controls:
                    self.after_controls(self._active())
            if changed:
                self._start_settling()
        except BaseException:
            self._fail()

    def _active(self) -> int:
        """Return the active controls last read, with the emergency stop."""
        if self._estop and self._estop.value():
            return self._controls_seen | EMERGENCY_STOP
        return self._controls_seen

    def controls(self) -> int:
        """Return the mask of active control inputs: reset, hold, start, door."""
        return _mask(self._controls) ^ self._control_invert

    def _is_open(self) -> bool:
        """Return whether the emergency stop is pressed: its contact opens."""
        return self._estop is not None and self._estop.value() == 1

    # The probe

    def watch_probe(self, on_contact: "Callable[[], None] | None", closed: bool) -> None:
        """Call on_contact once as soon as probe() returns `closed`: at once if it does now, else
        in an interrupt. None: stop watching."""
        self._on_contact = None  # an interrupt in between calls nothing
        self._contact_level = closed
        self._misses = 0
        self._on_contact = on_contact
        self._arm_probe()
        self._look_at_probe()

    def _arm_probe(self) -> None:
        """Enable the probe's interrupt for the edge of a contact, or none if nothing watches."""
        if self._probe:
            edge = Pin.IRQ_FALLING if self._contact_level else Pin.IRQ_RISING
            self._probe.irq().trigger(edge if self._on_contact else 0)

    @micropython.native
    def _probe_changed(self, pin: "Pin") -> None:
        """Report a contact if the pin still has its level. After too many edges that were over by
        then disarm the pin for a while. Interrupt."""
        try:
            self._misses += 1  # unless this is the contact: then the number no longer matters
            is_bouncing = self._misses >= _MOST_MISSES
            if is_bouncing:
                pin.irq().trigger(0)
            self._look_at_probe()
            if is_bouncing:
                self._start_look_timer(0)
        except BaseException:
            self._fail()

    def _look_at_probe(self) -> None:
        """Call on_contact, once, if the probe has the level that is waited for."""
        if self.probe() != self._contact_level:
            return
        on_contact = self._on_contact  # only now: None if an interrupt has just called it
        self._on_contact = None
        if on_contact:
            on_contact()
            self._arm_probe()  # disarms it: nothing watches any longer

    def probe(self) -> bool:
        """Return whether the probe input is pulled to ground."""
        return self._probe is not None and self._probe.value() == 0

    def levels(self) -> int:
        """Return all inputs as one mask, active controls and closed contacts as 1: reset, hold,
        start, door, from bit PROBE_AT on the probe and the limits (base.controls)."""
        return _mask(self._inputs) ^ self._control_invert

    # Inputs of extras

    def sense(self) -> int:
        """Return the levels of an extra's inputs, a bit each: 0 is closed."""
        all_bits = (1 << len(self._sensors)) - 1
        return all_bits ^ _mask(self._sensors)

    def watch_pins(self, on_change: "Callable[[], None]") -> None:
        """Call on_change, in an interrupt, whenever an extra's input changes, and once more when a
        disarmed one is read again."""
        self._on_sensor = on_change
        self._enable_interrupts(self._sensors, self._sensor_changed)
        _arm(self._sensors, _BOTH_EDGES)

    @micropython.native
    def _sensor_changed(self, pin: "Pin") -> None:
        """Report a changed input of an extra. The look timer arms it again. Interrupt."""
        try:
            pin.irq().trigger(0)
            self._sensors_disarmed = True
            self._on_sensor()
            self._start_look_timer(0)
        except BaseException:
            self._fail()


def _arm(pins: "Iterable[Pin | None]", edges: int) -> None:
    """Enable the pins' interrupts for these edges; 0 disarms them."""
    for pin in pins:
        if pin:
            pin.irq().trigger(edges)


@micropython.native
def _mask(pins: "list[Pin | None] | tuple[Pin | None, ...]") -> int:
    """Return a mask of the pins that are closed (pulled to ground): bit i for pins[i]."""
    mask = 0
    bit = 1
    for pin in pins:
        if pin and not pin():
            mask |= bit
        bit <<= 1
    return mask
