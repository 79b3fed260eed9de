"""The interfaces between parts of the firmware, for mypy. Never copied to a board.

An implementation need not inherit from these: mypy checks each one where `wiring.build()` is
called.
"""

from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import IO, Any, Protocol

from base.hooks import Hooks
from base.settings import Settings
from control.canon import Canon as MachineCanon
from control.homing_probing import HomingProbing
from control.inputs import Inputs
from control.spindle import Spindle
from extras.api import Cnc
from language.block import Block
from motion.arc_geometry import Arc
from motion.planner import Move, Planner
from talk.controller import Controller
from talk.report import Report

# The machine. Each part uses those that were created before it: boot/wiring.py has the order.
Machine = Controller

# Fills one segment row (see layout.py) and returns 1, or returns 0 if no motion is due. Called
# from the engine's interrupt: it neither allocates nor raises.
NextSegment = Callable[[array[int]], int]

# (target, move, away, alarms): moves to a target until contact, or with `away` until it is lost;
# `alarms`: a failure is an alarm. Returns whether the target has been reached.
Probe = Callable[[array[float], Move, bool, bool], bool]

class StepEngine(Protocol):
    """Generates step pulses: pio, rmt, i2s or the simulator.

    The engine pulls: it requests a segment whenever its hardware has space.
    """

    tick_hz: int  # unit of every time in a segment row
    segment_log2: int  # a full segment lasts 2**segment_log2 ticks

    def max_step_hz(self, pulse_us: int) -> int:
        """Return the highest rate of one axis with step pulses of pulse_us microseconds."""

    def attach(
        self,
        next_segment: NextSegment,
        on_power: Callable[[int], None],
        on_rest: Callable[[], None],
    ) -> None:
        """Set the source of segments, and two callbacks: one is passed the spindle power of each
        segment as it starts, the other is called in the engine's interrupt when motion has ended
        because there are no more segments."""

    def configure(self, pulse_us: int, step_invert: int, dir_invert: int) -> None:
        """Apply $0, $2 and $3. Called while idle only."""

    def arm(self) -> None:
        """Enable motion after power-up or stop(). For the main loop, which then checks whether
        something has stopped the machine meanwhile."""

    def start(self) -> None:
        """Begin to pull, if the engine had run out of segments. A stopped engine stays stopped."""

    def stop(self) -> object:
        """Stop at once, until arm(). Safe in an interrupt, even one within start() or within the
        engine's own. Drops queued steps and releases locks."""

    def fault(self) -> str:
        """Return the engine's fault, in words: its interrupt has failed, or motion is late for its
        own schedule. "" without a fault. For the main loop, in every turn."""

    def lock(self, motors: int) -> None:
        """Stop the pulses of these motors (a mask) until stop(); the others continue."""

    def idle(self) -> bool:
        """Return whether nothing moves and nothing is queued in hardware."""

    def position(self, steps: array[int]) -> None:
        """Copy the steps really made, per motor: the only truth."""

    def set_position(self, steps: array[int]) -> None:
        """Set the present position, also of locked motors. Only while idle."""

class AxisLimits(Protocol):
    """What the planner has to know of its axes: the machine's settings, or a group's axes. Rates
    and accelerations are per minute and per minute squared."""

    @property
    def steps_per_mm(self) -> Sequence[float]: ...
    @property
    def max_rate(self) -> Sequence[float]: ...
    @property
    def acceleration(self) -> Sequence[float]: ...
    @property
    def junction_deviation_mm(self) -> float: ...

class PlannerState(Protocol):
    """What the planner reads of the machine's state. Overrides are in percent."""

    @property
    def hooks(self) -> Hooks: ...
    @property
    def feed_override(self) -> float: ...
    @property
    def rapid_override(self) -> float: ...

class BeamEngine(StepEngine, Protocol):
    """An engine that changes the power of a beam: see motion/beam_layout.py."""

    beam: array[int]  # the beam's state
    levels: Any  # its ring of levels, integers

    def scale(self, power_max: int) -> None:
        """Set the level of full power again after a change of PWM frequency. Only while idle."""

    def put_out(self) -> object:
        """Send no more levels to the pin until motion starts again. Safe in an interrupt."""

class Canon(Protocol):
    """The canonical machining functions that the interpreter calls. Targets are absolute, in mm of
    machine coordinates. All waits are in them, and a reset raises Abort there; in check mode
    nothing moves."""

    planner: Planner  # receives move-only lines
    travel: array[int]  # their limits: see canon.check_travel()
    course: array[int]  # the arc in progress: see arcs.py

    def make_room(self) -> None:
        """Wait until the planner has space for a line."""

    def line(self, target: array[float], move: Move) -> None:
        """Request a straight line, rapid or feed by the move's flags; finish() executes it."""

    def arc(self, start: array[float], target: array[float], arc: Arc, move: Move) -> None:
        """Request an arc or helix; finish() executes it."""

    def jog(self, target: array[float], move: Move) -> None:
        """Request a line that starts at once, and that a hold cancels; finish() executes it."""

    def finish(self) -> None:
        """Plan the requested move."""

    def synchronise(self) -> None:
        """Wait until all planned motion is executed."""

    def dwell(self, seconds: float) -> None:
        """Wait without motion; hold and reset work meanwhile."""

    def spin(self, direction: int, rpm: float) -> None:
        """Set spindle direction and speed after all planned motion."""

    def cool(self, mask: int) -> None:
        """Switch coolant after all planned motion."""

    def control_overrides(self, parking: bool) -> None:
        """Execute M56: enable or disable parking."""

    def pause_program(self) -> None:
        """Execute M0: hold until cycle start."""

    def end_program(self) -> None:
        """Switch spindle and coolant off, and set overrides to 100 %."""

    def outside(self, target: array[float]) -> bool:
        """Return whether the target is outside the machine's travel."""

class Motion(Protocol):
    """A motion mode of an extra, in addition to lines, arcs and probes."""

    kept: list[float | None]  # numbers that stay in force as long as the mode

    def check(self, block: Block) -> None:
        """Refuse a block with GrblError; nothing has changed yet. Its target is in block.xyz.
        Check that it has no MOTION_WORDS that the motion does not use."""

    def make(self, block: Block, move: Move) -> None:
        """Execute its moves, and set Modes.position to their end."""

class Kinematics(Protocol):
    """Which motor moves which axes, if they do not move one each: motion/kinematics.py.

    Steps are whole, of all motors or of one axis.
    """

    @property
    def moves(self) -> Sequence[int]:
        """A number per motor, at least one per axis: layout.MOVES."""

    def axis_steps(self, motors: array[int], axis: int) -> int:
        """Return the steps of an axis, from those of the motors."""

    def to_axes(self, motors: array[int]) -> None:
        """Replace the steps of the first motors by those of the axes. Takes no memory."""

    def set_axis(self, motors: array[int], axis: int, steps: int) -> None:
        """Change the steps of an axis' motors so that it is there, and no other axis moves."""

    def stopped_by(self, switches: int) -> int:
        """Return the motors (a mask) that stop at these limit switches (a mask)."""

class Geometry(Protocol):
    """The user's own kinematics, a module next to the board file.

    A place is the tool's position, in mm; joints are one per motor, in units of their own.
    """

    START: Sequence[float]  # joints at power-up,
    HOME: Sequence[float]  # and when their switches close
    TRAVEL: Sequence[float]  # greatest distance to a switch
    CENTRED: Sequence[int]  # axes whose travel is to either side of 0
    FASTEST: float  # mm/min: no motion is faster

    def inverse(self, place: array[float], joints: array[float]) -> bool:
        """Compute the joints; on entry they hold their present values. False: out of reach."""

    def forward(self, joints: array[float], place: array[float]) -> object:
        """Compute the place."""

class InputListener(Protocol):
    """Receives events of a port's inputs, in interrupt context. An object, not three callables,
    because a call of a method needs less stack than a call of a bound method object."""

    def on_limits(self) -> None:
        """Handle a change of a limit switch."""

    def on_controls(self, active: int) -> None:
        """Handle a change of a control input or the emergency stop. active: mask."""

    def on_fault(self) -> None:
        """Handle an exception in a callback; kill() has been called."""

class Pwm(Protocol):
    """Generates the pulses of the spindle's power: machine.PWM."""

    def freq(self, hz: int = ..., /) -> int:
        """Return the frequency; hz: change it at once, with the same duty."""

class Port(Protocol):
    """All pins except step and direction, and the clock."""

    pwm_max: int  # spindle(): full power
    limit_invert: int  # limits() while no switch is hit; set by Inputs
    estop: Callable[[], bool] | None  # whether the emergency stop is pressed; None: not wired
    fault: str  # a fault of the inputs, in words; "" without one
    # An extra's, called with the mask after InputListener.on_controls(), in the interrupt too.
    after_controls: Callable[[int], object] | None

    @property
    def pwm(self) -> Pwm | None:
        """Power of spindle or laser; None if there is no such output."""

    def attach(self, listener: InputListener) -> None:
        """Set the listener, which is called in interrupt context when an input changes."""

    def enable_limits(self, on: bool) -> None:
        """Call on_limits at changes of limit inputs, or do not ($21). After a call an input is
        ignored for some milliseconds, and then checked again."""

    def safe(self) -> None:
        """Switch off spindle, laser, coolant, and outputs of extras."""

    def kill(self) -> object:
        """Switch off spindle, laser, coolant, and outputs of extras. They stay off until revive(),
        whatever is called meanwhile. The first action of an interrupt that must stop the machine;
        needs little stack."""

    def revive(self) -> None:
        """Enable these outputs again. For the main loop, which then checks whether something has
        stopped the machine meanwhile."""

    def watch_probe(self, on_contact: Callable[[], None] | None, closed: bool) -> None:
        """Call on_contact once, in interrupt context, as soon as the probe pin is `closed`."""

    def limits(self) -> int:
        """Return a mask of limit inputs pulled to ground, bit 0 = X."""

    def controls(self) -> int:
        """Return a mask of active control inputs: RESET, HOLD, START, DOOR of base.controls."""

    def probe(self) -> bool:
        """Return whether the probe input is pulled to ground."""

    def levels(self) -> int:
        """Return all of these at once; base.controls has the bits."""

    def enable(self, level: int) -> None:
        """Set the level of the motor drivers' enable pin."""

    def direction(self, level: int) -> None:
        """Set the level of the spindle direction pin: 1 = counterclockwise."""

    def spindle(self, on: bool, power: int) -> None:
        """Set the spindle's enable and PWM power, 0..pwm_max. Safe in an interrupt."""

    def coolant(self, mask: int) -> None:
        """Set the coolant outputs: coolant.FLOOD, coolant.MIST."""

    def add_pins(self, outputs: tuple[int, ...], inputs: tuple[int, ...]) -> None:
        """Add an extra's pins: outputs that drive() sets, inputs that sense() reads."""

    def drive(self, levels: int) -> None:
        """Set the levels of the outputs of add_pins(), a bit each. Safe in an interrupt."""

    def pulse(self, index: int, hz: int, duty: int) -> None:
        """Make output `index` pulse: hz times per second, on for duty / 65535 of the time."""

    def rest(self, levels: int) -> None:
        """Set the levels of these outputs that kill() sets."""

    def sense(self) -> int:
        """Return the levels of the inputs of add_pins(), a bit each."""

    def watch_pins(self, on_change: Callable[[], None]) -> None:
        """Call on_change, in interrupt context, when one of those inputs changes, and again when
        it is checked once more, some milliseconds later."""

    def ticks_ms(self) -> int:
        """Return milliseconds, modulo some power of two; compare with elapsed_ms."""

    def elapsed_ms(self, since: int) -> int:
        """Return the milliseconds since a value of ticks_ms()."""

class GroupHardware(Protocol):
    """Engine, pins and clock of a group of axes: ugrbl_motion/hardware.py, or the simulator."""

    def engine(self, step: tuple[int, ...], direction: tuple[int, ...]) -> StepEngine:
        """Create the step engine. Raises OSError if there is none."""

    def make_outputs(self, pins: Sequence[int], levels: int) -> None:
        """Create the outputs that write() sets, with these levels, a bit each."""

    def write(self, levels: int) -> None:
        """Set the outputs, a bit each. Called in an interrupt."""

    def watch(
        self, number: int, level: int, on_change: Callable[[], object]
    ) -> Callable[[], bool]:
        """Call on_change, in interrupt context, when the input gets that level. Returns a function
        that returns whether it has the level."""

    def sleep_ms(self, milliseconds: int) -> None:
        """Wait."""

class BoardPort(Port, Protocol):
    """A Port of a real board, with what power_up needs in addition."""

    def safe(self) -> None:
        """Switch off everything that could do harm, once; motors are not changed."""

    def held(self, pin: int | None) -> bool:
        """Return whether a button between this pin and ground is held."""

    def watch(self, timeout_ms: int) -> Callable[[], None] | None:
        """Start the watchdog: the chip resets if the result is not called for timeout_ms. 0 ends
        it."""

class DriverWire(Protocol):
    """A serial line to motor drivers: ports/driver_wire.py."""

    def exchange(self, request: bytes | bytearray, answer_bytes: int) -> bytes | None:
        """Send, and return the answer, or as much as was received. None: the wire is broken."""

class PreparedPages(Protocol):
    """Pages of flash that are erased in advance: ports/storage/prepared_page.py."""

    def find(self) -> None:
        """Find them. To be called before the other methods."""

    def is_fresh(self) -> bool:
        """Return whether all pages are free."""

    def erase(self) -> bool:
        """Erase them. Returns is_fresh()."""

    def write(self, record: bytes | bytearray) -> bool:
        """Write a record, without an erasure. Returns whether it was stored."""

    def records(self) -> Iterator[bytes]:
        """Yield the records, the newest first."""

class PowerInput(Protocol):
    """A monitor of the supply: ports/power_input.py."""

    @property
    def pages(self) -> PreparedPages:
        """Pages of flash for what must be stored."""

    @property
    def is_armed(self) -> bool:
        """Whether the next failure calls on_fail; interference ends that."""

    def attach(self, on_fail: Callable[[], object], on_fault: Callable[[], object]) -> None:
        """Call on_fail, in an interrupt, when the supply fails; on_fault if that raises."""

    def is_good(self) -> bool:
        """Return whether the supply is good."""

    def arm(self) -> None:
        """Call on_fail again at the next failure."""

class Job(Protocol):
    """The running job, for what must be recorded, and for a sender that has gone:
    extras/jobs/job_run.py."""

    def is_on(self) -> bool:
        """Return whether a job runs."""

    def has_partial_line(self) -> bool:
        """Return whether the sender has begun a line."""

    def drop_partial_line(self) -> None:
        """Drop the sender's unfinished line."""

    def line_at_stop(self, is_certain: bool) -> tuple[int, int]:
        """Return its line, and the CRC-32 of its file; zeros if none runs."""

    def correct(self, line: int, crc: int) -> str:
        """Store the line of the unfinished job with this CRC-32. Returns its name, or ""."""

class JobFiles(Protocol):
    """Programs stored on the board, by name. Failures raise OSError."""

    on_progress: Callable[[], object]  # called repeatedly while files are read through

    def mount(self) -> None:
        """Make the files accessible. No file may be open."""

    def lose(self) -> bool:
        """After an OSError: forget the medium, so that mount() starts again. Returns whether it is
        removable."""

    def is_name(self, name: str) -> bool:
        """Return whether a program may have this name."""

    def files(self) -> list[tuple[str, int]]:
        """Return names and sizes in bytes, in order."""

    def size(self, name: str) -> int:
        """Return the size in bytes; -1 if there is no such program."""

    def open(self, name: str) -> IO[bytes]:
        """Open a program for reading."""

    def free_kb(self) -> int:
        """Return the free space, in kB."""

    def delete(self, name: str) -> None:
        """Delete a program."""

    def begin(self, name: str) -> IO[bytes]:
        """Open a file for a new program of this name."""

    def append(self, file: IO[bytes], piece: bytes | bytearray) -> None:
        """Write the next piece."""

    def finish(self, name: str, file: IO[bytes], checksum: int) -> bool:
        """Replace the program by the new file. If the CRC-32 differs from checksum the old program
        stays, and False is returned."""

    def drop(self, name: str, file: IO[bytes]) -> None:
        """Discard the new file."""

class Card(Protocol):
    """A removable folder."""

    folder: str
    shared: array[int]  # with the supervisor, see ports/supervisor.py

    def mount(self) -> None:
        """Mount the present medium at its folder. Raises OSError if that fails."""

    def unmount(self) -> None:
        """Forget the medium."""

    def check(self) -> None:
        """Raise OSError if something could not be read or written since."""

class Options(Protocol):
    """Options that an extra's prepare() may change before the machine is built."""

    axes: int
    axis_letters: bytes  # of these axes, and more
    kinematics: Kinematics | None  # None: each motor moves the axis of its own number
    settings: type[Settings]
    inputs: type[Inputs]
    homing_probing: type[HomingProbing]
    planner: type[Planner]
    canon: type[MachineCanon]
    report: type[Report]  # or one of another dialect
    spindle: type[Spindle]  # or a tool with the same methods
    reads: tuple[int, int, int]  # talk/lines.py
    highest_tool: int
    line_length: int  # characters of a line
    rx_bytes: int  # that a sender may send before they are answered
    defaults: dict[int, float]  # settings that differ from Grbl's
    custom: tuple[str, ...]  # the user's own modules
    job_files: JobFiles | None  # programs stored on the board
    driver_wire: DriverWire | None  # to motor drivers with a serial line
    power_input: PowerInput | None  # the supply's monitor

class Extra(Protocol):
    """A module of extras/, or a user's. It may have PINS, the board file's options that name its
    pins; EXCLUDED, its own option and those not allowed with it; and prepare(options, board),
    called before the machine is built."""

    def install(self, cnc: Cnc) -> None:
        """Change the machine, once it is built."""

class Voice(Protocol):
    """Output that lower parts may use: talk/report.py, in the words of its dialect."""

    @property
    def send(self) -> Callable[[bytes | bytearray | memoryview], None]:
        """Write bytes unchanged."""

    def message(self, text: str) -> None:
        """Send a message to the user."""

    def alarm(self, code: int) -> None:
        """Report an alarm."""

    def status(self) -> memoryview:
        """Return the answer to ?. Send it before the next call."""

    def probe(self, probe: array[float]) -> None:
        """Report the position of the last contact, mm, and whether there was one."""

class Link(Protocol):
    """The connection to the sender: USB, UART, a pseudo-terminal, a test."""

    def read_into(self, buf: bytearray) -> int:
        """Move received bytes into buf; return how many. Never waits long."""

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Send; waits if the line is slower."""

    def discard(self) -> None:
        """Drop bytes that were received and not yet read."""

class BoardLink(Link, Protocol):
    """A Link of a real board, with what power_up and the supervisor need in addition."""

    shared: array[int]  # with the supervisor, see ports/supervisor.py
    check_supervisor: Callable[[], None]  # the supervisor's, called in the main loop; may raise
    is_slow: bool  # Ctrl-X takes effect only when the main loop reads

    @property
    def poll_reset(self) -> Callable[[], int] | None:
        """Called by the supervisor, in its interrupt: whether a Ctrl-X was received. None if only
        reading can show it."""

    def attach(self, at_rest: Callable[[], bool], on_open: Callable[[], None]) -> None:
        """Set two functions: whether the REPL may be entered, and the welcome of a sender that
        opens the port again."""

    def close(self) -> None:
        """Hand the link over to MicroPython's prompt."""

class Radio(Protocol):
    """The board's radio, for ports/net/net_link.py: ports/net/radio.py."""

    def poll_radio(self, at_rest: bool) -> None:
        """Try to rejoin a lost network. at_rest: the machine is idle."""

class Access(Protocol):
    """Decides which clients may do more than read: ports/net/access.py."""

    secret: str  # a client that sends it may

    def random_bytes(self, count: int) -> bytes:
        """Return that many unpredictable bytes."""

class Connection(Protocol):
    """A client's connection over the network: MicroPython's socket, which never waits."""

    def readinto(self, buf: bytearray, /) -> int | None:
        """Move received bytes into buf; None if there are none, 0 if the client has closed."""

    def write(self, data: bytes | bytearray | memoryview, /) -> int | None:
        """Send as much as there is space for; None if there is none."""

    def close(self) -> None:
        """Close the connection."""

class Incoming(Protocol):
    """Accepts clients over the network: ports/net/tcp.py."""

    def next(self) -> tuple[Connection, str] | None:
        """Return the next client and its address; None if there is none."""

    def close(self) -> None:
        """Stop listening."""

class Control(Protocol):
    """The controlling client of a machine on the network, for extras/net/net_access.py."""

    ending: bool  # lines of the previous client are not finished yet
    drop_partial_line: Callable[[], None]  # drops a line received in part
    has_partial_line: Callable[[], bool]  # whether a line was received in part

    def done(self) -> None:
        """Note that these lines are finished."""

class NetworkLink(Link, Protocol):
    """A Link with the cable and a network, for extras/net/net_access.py."""

    access: Access
    control: Control
    status: Callable[[], str]  # state of the radio

    def forget_lines(self) -> None:
        """Forget the lines that a reset drops."""

    def by_cable(self) -> bool:
        """Return whether the controlling client is on the cable."""

    def answer(self, data: bytes) -> None:
        """Write only to the client whose line is executed."""

    def write_cable(self, data: bytes) -> None:
        """Write to the cable only."""

    def client_count(self) -> int:
        """Return how many clients are connected."""

    def expel(self) -> None:
        """Close all their connections."""

class Store(Protocol):
    """Text lines that survive power-off, by name."""

    # Names whose newest copy load() could not read; True if it returned an older one.
    damaged: dict[str, bool]

    def load(self, name: str) -> list[str] | None:
        """Return the lines: an empty list if there never were any under that name, None if they
        are lost."""

    def save(self, name: str, lines: Iterable[str]) -> None:
        """Replace them at once or not at all. Raises OSError."""
