"""The machine as a whole: position, settings, power-up, reset."""

from array import array

from base import errors
from base import state as st
from base.hooks import call_all
from control import spindle as sp
from control.modes import RPM, SPINDLE
from micropython import const

_FLASH_MS = const(2500)  # longest save: it erases at most six sectors of flash, each in 400 ms

# Settings whose change acts at once.
_REPORT_INCHES = const(13)  # number of the setting: $13
_HARD_LIMITS = const(21)  # $21
_MAX_RPM = const(30)  # $30
_MIN_RPM = const(31)  # $31

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from base.settings import Settings
    from base.state import State
    from control.canon import Canon
    from control.coolant import Coolant
    from control.coords import Coords
    from control.homing_probing import HomingProbing
    from control.inputs import Inputs
    from control.modes import Modes
    from control.motor_control import MotorControl
    from control.overrides import Overrides
    from control.realtime import Realtime
    from control.saves import Saves
    from control.spindle import Spindle
    from control.suspension import Suspension
    from interfaces import Port, StepEngine
    from language.interpreter import Interpreter
    from motion.planner import Planner
    from motion.segments import Segments

    from talk.commands import Commands
    from talk.lines import LineReader
    from talk.protocol import Protocol
    from talk.report import Report


class Controller:
    """Hold all parts of the machine, each an attribute below; wiring.build() makes it. motors:
    number of motors; _steps: scratch, one position per motor."""

    port: "Port"
    engine: "StepEngine"
    state: "State"
    saves: "Saves"
    settings: "Settings"
    coords: "Coords"
    planner: "Planner"
    segments: "Segments"
    spindle: "Spindle"
    coolant: "Coolant"
    inputs: "Inputs"
    report: "Report"
    canon: "Canon"
    homing_probing: "HomingProbing"
    motor_control: "MotorControl"
    modes: "Modes"
    interpreter: "Interpreter"
    overrides: "Overrides"
    realtime: "Realtime"
    suspension: "Suspension"
    commands: "Commands"
    reader: "LineReader"
    protocol: "Protocol"

    def __init__(self, motors: int) -> None:
        self._steps = array("i", (0 for _ in range(motors)))

    # Positions: machine (steps executed) -> planner -> parser

    def position(self, mm: "array[float]") -> None:
        """Copy the machine position, from the steps executed, into mm (one float per axis)."""
        self.engine.position(self._steps)
        self.planner.to_mm(self._steps, mm)

    def resync(self) -> None:
        """Set the planner's and the parser's position from the steps executed."""
        self.engine.position(self._steps)
        self.planner.sync_motors(self._steps)
        self.planner.to_mm(self._steps, self.modes.position)

    # Settings

    def configure(self) -> None:
        """Pass a changed setting to the parts that derive values from it. settings.changed is its
        number."""
        settings = self.settings
        engine = self.engine
        engine.configure(settings.step_pulse_us, settings.step_invert, settings.dir_invert)
        self.planner.configure(
            settings,
            engine.tick_hz,
            engine.segment_log2,
            engine.max_step_hz(settings.step_pulse_us),
        )
        self.spindle.configure(settings, self.planner.table)
        # Only when these change: each call has an effect of its own.
        if settings.changed == _HARD_LIMITS:
            self.port.enable_limits(bool(settings.hard_limits))
        if settings.changed in (_MAX_RPM, _MIN_RPM):
            self.spindle.stop()  # its power was computed with the old ones
        if settings.changed == _REPORT_INCHES:
            self.state.wco_countdown = 0  # the next report has the offset in the new unit

    # Life

    def power_up(self) -> None:
        """Load the stored data, attach the interrupt handlers and power the motors. Then
        protocol.run() takes over. With homing ($22) the machine begins in Alarm."""
        self.engine.attach(
            self.state.hooks.next_segment, self.spindle.set_power, self.spindle.on_motion_end
        )
        settings_valid = self._load_stored(self.settings.load)
        if not settings_valid:
            # As Grbl does with erased memory: report it and print the settings in force.
            self.report.error(errors.SETTING_READ_FAIL)
            self.commands.show_settings()
        self._load_stored(self.commands.load)
        self._load_stored(self.coords.load)
        if settings_valid and self.saves.damaged:  # the banner says which
            self.report.error(errors.SETTING_READ_FAIL)
        self.port.attach(self.motor_control)
        if self.settings.homing:
            self.state.enter(st.ALARM)
        self.motor_control.power(True)

    def _load_stored(self, load: "Callable[[], bool | None]") -> "bool | None":
        """Call load, which loads stored data, and write at once the defaults that it has set if
        there was none. Returns its result: False if data was invalid, or None for no result."""
        valid = load()
        self.save_due()
        return valid

    def at_rest(self) -> bool:
        """Return whether nothing moves or is planned, and no extra is about to move."""
        for is_busy in self.state.hooks.is_busy:
            if is_busy():
                return False
        return self.stands()

    def stands(self) -> bool:
        """Return whether nothing moves or is planned; extras may still be about to move."""
        return self.state.run in (st.IDLE, st.ALARM) and self.planner.empty()

    def welcome(self) -> None:
        """Greet a sender that has opened the port anew, also during motion: some senders reset a
        machine that says nothing. The reset hooks of extras run only while idle."""
        if self.at_rest():
            self._banner()
        else:
            self.report.banner()

    def _banner(self) -> None:
        """Print the banner and run the reset hooks of extras. Damaged data is reported each time
        until power-off, because at power-up no sender may have opened the port yet."""
        self.report.banner()
        call_all(self.state.hooks.reset)
        for name, has_older in self.saves.damaged.items():
            self.report.message(errors.MSG_DAMAGED % (name, "older copy" if has_older else "lost"))

    def around_saves(
        self, allow: "Callable[[int], None]", written: "Callable[[], None] | None"
    ) -> "tuple[Callable[[], None], Callable[[], None]]":
        """Return the functions to call before and after a flash write, which blocks all
        interrupts; the machine is idle then.

        A spindle keeps turning. A laser that M3 has switched on would burn longer than the program
        says, so it is off during the write. allow: sets by how many ms the main loop's next turn
        may be longer without a reset by the watchdog; written: notifies the engine after a write,
        None if it needs no notice.
        """
        lit = False  # before() has switched a laser off, which after() switches on again
        state, spindle, modes = self.state, self.spindle, self.modes

        def before() -> None:
            """Allow the loop a long turn, and switch off a laser that shines without motion."""
            nonlocal lit
            allow(_FLASH_MS)
            # CW: by M3; a laser that M4 has switched on is dark while nothing moves
            lit = spindle.laser and modes.modal[SPINDLE] == sp.CW and spindle.is_on()
            if lit:
                spindle.stop()

        def after() -> None:
            """Undo before(), unless a reset has come."""
            if written:
                written()
            allow(0)
            if lit and not state.pending[st.RESET]:
                spindle.set_speed(sp.CW, modes.rates[RPM])

        return before, after

    def restart(self) -> None:
        """Reset the machine, wait until the idle delay ($1) is over, greet, and run the startup
        lines. Raises Abort if another reset comes."""
        self._reset()
        self.motor_control.wait_idle_delay()
        self.save_due()  # saves that the reset cut short
        self._greet()

    def save_due(self) -> None:
        """Write pending saves; the machine is idle. Data that cannot be written is reported, and
        stays valid until power-off."""
        try:
            self.saves.write_due()
        except OSError:
            self.report.message(errors.MSG_NOT_KEPT)

    def _reset(self) -> None:
        """Stop everything and set the modes of a fresh start; the position is kept."""
        state = self.state
        state.clear()
        state.pending[:] = bytes(len(state.pending))  # all 0: drop all events
        state.alarm = 0
        self.engine.stop()
        self.reader.clear()
        self.coords.clear()
        self.modes.reset()
        self.canon.clear_request()
        self.planner.clear()
        self.planner.override()
        self.segments.clear()
        self.spindle.set_speed(sp.OFF, 0.0)
        self.coolant.set(0)
        state.hooks.forget()  # the probed position, and what extras hold
        self.motor_control.release()  # starts the idle delay
        self.resync()
        state.override_countdown = 0
        self.port.enable_limits(bool(self.settings.hard_limits))
        self.motor_control.arm()

    def _greet(self) -> None:
        """Print the banner, decide between Idle and Alarm, and in Idle run the startup lines. The
        state is Alarm after an alarm, before homing ($22), after sleep, and while a limit switch
        ($21) or the emergency stop is active."""
        state = self.state
        self._banner()
        if self.settings.is_new:  # a message, not an error: senders stop at errors
            self.settings.is_new = False
            self.report.message(errors.MSG_FIRST_START)
        if self.settings.hard_limits and self.inputs.limits():
            state.enter(st.ALARM)
            self.report.message(errors.MSG_CHECK_LIMITS)
        if self.inputs.estop():
            state.enter(st.ALARM)
            self.report.message(errors.MSG_EMERGENCY_STOP)
        if state.run & (st.ALARM | st.SLEEP):
            self.report.message(errors.MSG_ALARM_LOCK)
            state.enter(st.ALARM)
            return
        state.enter(st.IDLE)
        if self.inputs.door_open():
            state.post(st.SAFETY_DOOR)
            self.realtime.run()
        self.commands.run_startup()
