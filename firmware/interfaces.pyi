"""The seams of the firmware, as mypy sees them. Never copied to a board.

An implementation need not inherit from these: mypy checks each one where
`wiring.build()` is called.
"""

from array import array
from collections.abc import Callable, Iterable, Sequence
from typing import IO, Any, Protocol

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

# The machine, of which each part takes what is there before it: boot/wiring.py has the order.
Machine = Controller

# Fills one segment row (see segments.py for its layout) and returns 1, or
# returns 0 where no motion is due. Called from the engine's interrupt: it
# neither allocates nor raises.
NextSegment = Callable[[array[int]], int]

# Moves to a target until contact, or until it is lost (away); alarms where it fails, if it is to.
# Returns whether the target has been reached.
Probe = Callable[[array[float], Move, bool, bool], bool]

class StepEngine(Protocol):
    """Who makes pulses: pio, rmt, i2s or the simulator.

    The engine pulls: it asks for a segment whenever its hardware has room.
    """

    tick_hz: int  # unit of every time in a segment row
    segment_log2: int  # a full segment lasts 2**segment_log2 ticks

    def max_step_hz(self, pulse_us: int) -> int:
        """Highest rate of one axis with step pulses of pulse_us microseconds."""

    def attach(
        self,
        next_segment: NextSegment,
        on_power: Callable[[int], None],
        on_rest: Callable[[], None],
    ) -> None:
        """Say where segments come from, who is told the spindle power of each as it starts, and
        who hears, in the engine's interrupt, that motion has come to its end for want of them."""

    def configure(self, pulse_us: int, step_invert: int, dir_invert: int) -> None:
        """Take over $0, $2 and $3. Called at rest only."""

    def arm(self) -> None:
        """Motion is possible again, after power-up or stop(). For the main loop, which looks
        behind it whether something has stopped the machine meanwhile."""

    def start(self) -> None:
        """Begin to pull, where the engine had run out of segments. A stopped engine stays so."""

    def stop(self) -> object:
        """At once, and for good until arm(); safe in an interrupt, also in one that has come
        into start() or into the engine's own; queued steps are dropped, locks released."""

    def fault(self) -> str:
        """What is wrong with the engine, in words: its interrupt has failed, or motion is behind
        its own schedule. "" as long as nothing is. For the main loop, at every turn."""

    def lock(self, motors: int) -> None:
        """These motors (a mask) make no more pulses until stop(); the others go on."""

    def idle(self) -> bool:
        """Nothing is moving and nothing is queued in hardware."""

    def position(self, steps: array[int]) -> None:
        """Copy the steps really made, per motor: the only truth."""

    def set_position(self, steps: array[int]) -> None:
        """Name the present place, also of motors that are locked. At rest only."""

class BeamEngine(StepEngine, Protocol):
    """An engine that changes the power of a beam: see motion/beam_layout.py."""

    beam: array[int]  # what is known of the beam
    levels: Any  # its ring of them, integers

    def scale(self, power_max: int) -> None:
        """The PWM has another frequency: set the level of full power anew. At rest only."""

    def put_out(self) -> object:
        """No level comes to the pin any more until motion begins anew. Safe in an interrupt."""

class Canon(Protocol):
    """The canonical machining functions: what the language may ask of the machine. Targets are
    absolute, in mm of machine coordinates. Who has to wait does so in them, and a reset raises
    Abort there; in check mode nothing moves."""

    planner: Planner  # where a line that does no more than move is put
    travel: array[int]  # and what it is held against first: see canon.check_travel()
    course: array[int]  # where arcs are laid: see arcs.py

    def make_room(self) -> None:
        """Wait until a line finds room in the planner."""

    def line(self, target: array[float], move: Move) -> None:
        """A straight line: rapid or feed, by the move's flags. Made by finish()."""

    def arc(self, start: array[float], target: array[float], arc: Arc, move: Move) -> None:
        """An arc, or helix. Made by finish()."""

    def jog(self, target: array[float], move: Move) -> None:
        """A line that starts at once, and that a hold would cancel. Made by finish()."""

    def finish(self) -> None:
        """Make what has been asked for."""

    def synchronise(self) -> None:
        """Wait until everything planned has been done."""

    def dwell(self, seconds: float) -> None:
        """Stand still; hold and reset work meanwhile."""

    def spin(self, direction: int, rpm: float) -> None:
        """Turn the spindle, once motion has come to where it was asked."""

    def cool(self, mask: int) -> None:
        """Switch coolant, once motion has come to where it was asked."""

    def control_overrides(self, parking: bool) -> None:
        """M56: parking is in action, or is not."""

    def pause_program(self) -> None:
        """M0: hold until cycle start."""

    def end_program(self) -> None:
        """Spindle and coolant off, overrides back to 100 %."""

    def outside(self, target: array[float]) -> bool:
        """The target lies outside the machine's travel."""

class Motion(Protocol):
    """A motion mode that an extra brings, besides lines, arcs and probes."""

    kept: list[float | None]  # numbers that hold while it is in force: a mode as well

    def check(self, block: Block) -> None:
        """Refuse a block with GrblError; nothing has changed yet. Its target is in block.xyz, and
        of MOTION_WORDS no more than the motion uses may be there."""

    def make(self, block: Block, move: Move) -> None:
        """Have its moves made, and say in Modes.position where they end."""

class Kinematics(Protocol):
    """Which motor moves which axes, where they do not move one each: motion/kinematics.py.

    Steps are whole ones, of all motors or of one axis.
    """

    @property
    def moves(self) -> Sequence[int]:
        """What each motor does, at least one per axis, as the kernels read it."""

    def axis_steps(self, motors: array[int], axis: int) -> int:
        """Steps of an axis from those of the motors."""

    def to_axes(self, motors: array[int]) -> None:
        """Put the steps of the axes where those of the first motors are. Takes no memory."""

    def set_axis(self, motors: array[int], axis: int, steps: int) -> None:
        """Change the steps of an axis' motors so that it stands there, and no other axis moves."""

    def stopped_by(self, switches: int) -> int:
        """The motors (a mask) that stop at these limit switches (a mask)."""

class Geometry(Protocol):
    """Kinematics of the user's own, a module beside the board file.

    Places are of the tool, in mm; joints one per motor, in units of their own.
    """

    START: Sequence[float]  # where the joints are at power-up,
    HOME: Sequence[float]  # and when their switches close
    TRAVEL: Sequence[float]  # how far it is to a switch, at the most
    CENTRED: Sequence[int]  # axes whose travel goes to either side of 0
    FASTEST: float  # mm/min: no motion is faster

    def inverse(self, place: array[float], joints: array[float]) -> bool:
        """Fill in the joints, which hold where they are before. False: out of reach."""

    def forward(self, joints: array[float], place: array[float]) -> object:
        """Fill in the place."""

class InputListener(Protocol):
    """Who hears of a port's inputs, in interrupt context. An object, and not three callables:
    to call a method needs less stack than to call what has been taken from it."""

    def on_limits(self) -> None:
        """A limit switch has changed."""

    def on_controls(self, active: int) -> None:
        """A control input has changed, or the emergency stop, which is one of them. Mask."""

    def on_fault(self) -> None:
        """A callback has raised; kill() has been called."""

class Pwm(Protocol):
    """What makes the pulses of the spindle's power: machine.PWM."""

    def freq(self, hz: int = ..., /) -> int:
        """How many there are in a second; hz: so many, at once, each as large a part as before."""

class Port(Protocol):
    """Pins that are not steps, and the clock."""

    pwm_max: int  # spindle(): full power
    limit_invert: int  # limits() where no switch is hit; Inputs sets it
    estop: Callable[[], bool] | None  # whether the emergency stop is pressed; None: not wired
    fault: str  # what is wrong with the inputs, in words; "" as long as nothing is
    # An extra's, called with the mask behind InputListener.on_controls(), in the interrupt too.
    after_controls: Callable[[int], object] | None

    @property
    def pwm(self) -> Pwm | None:
        """Power of spindle or laser; None: there is no such output."""

    def attach(self, listener: InputListener) -> None:
        """Who is called, in interrupt context, when an input changes."""

    def enable_limits(self, on: bool) -> None:
        """Call on_limits, or leave the limit inputs in peace ($21). An input that has called is
        looked at again some milliseconds later and not heard meanwhile."""

    def kill(self) -> object:
        """Spindle, laser, coolant, and outputs of extras, off; they stay off, whatever is asked of
        them, until revive(). What an interrupt that has to stop the machine does first; needs
        little stack."""

    def revive(self) -> None:
        """They obey again. For the main loop, which looks behind it whether something has
        stopped the machine meanwhile."""

    def watch_probe(self, on_contact: Callable[[], None] | None, closed: bool) -> None:
        """Call on_contact once, in interrupt context, as soon as the probe pin is `closed`."""

    def limits(self) -> int:
        """Mask of limit inputs pulled to ground, bit 0 = X."""

    def controls(self) -> int:
        """Mask of control inputs that are active: base.controls: RESET, HOLD, START, DOOR."""

    def probe(self) -> bool:
        """The probe input is pulled to ground."""

    def levels(self) -> int:
        """All of these at once: base.controls says which bit is whose."""

    def enable(self, level: int) -> None:
        """Level of the motor drivers' enable pin."""

    def direction(self, level: int) -> None:
        """Level of the spindle direction pin: 1 = counterclockwise."""

    def spindle(self, on: bool, power: int) -> None:
        """Spindle output: enable, and PWM power 0..pwm_max. May be called in an interrupt."""

    def coolant(self, mask: int) -> None:
        """Coolant outputs: coolant.FLOOD, coolant.MIST."""

    def add_pins(self, outputs: tuple[int, ...], inputs: tuple[int, ...]) -> None:
        """Pins of an extra: outputs that drive() sets, inputs that sense() reads."""

    def drive(self, levels: int) -> None:
        """Levels of the outputs of add_pins(), a bit each. May be called in an interrupt."""

    def pulse(self, index: int, hz: int, duty: int) -> None:
        """Have that output make pulses: hz in a second, on for duty / 65535 of the time."""

    def rest(self, levels: int) -> None:
        """The levels that kill() sets."""

    def sense(self) -> int:
        """Levels of the inputs of add_pins(), a bit each."""

    def watch_pins(self, on_change: Callable[[], None]) -> None:
        """Call on_change, in interrupt context, when one of those inputs changes, and once more
        when that one is looked at again, some milliseconds later."""

    def ticks_ms(self) -> int:
        """Milliseconds, wrapping at some power of two; compare with elapsed_ms."""

    def elapsed_ms(self, since: int) -> int:
        """Milliseconds since a value of ticks_ms()."""

class BoardPort(Port, Protocol):
    """A Port of a real board: what power_up wants besides."""

    def safe(self) -> None:
        """What could do harm off, once; motors stay as they are."""

    def held(self, pin: int | None) -> bool:
        """A button between this pin and ground is held."""

    def watch(self, timeout_ms: int) -> Callable[[], None] | None:
        """Make the chip start anew where the result is not called for so long; 0: no more."""

class DriverWire(Protocol):
    """A serial line to motor drivers: ports/driver_wire.py."""

    def exchange(self, request: bytes | bytearray, answer_bytes: int) -> bytes | None:
        """Send, and return the answer, or what has come of it. None: the wire is broken."""

class JobFiles(Protocol):
    """Programs that live on the board, by name. What cannot be done is an OSError."""

    on_progress: Callable[[], object]  # called while files are gone through

    def mount(self) -> None:
        """See to it that they can be reached. None may be open."""

    def lose(self) -> bool:
        """Behind an OSError: mount() begins anew. Returns whether they can be taken out."""

    def is_name(self, name: str) -> bool:
        """Whether a program may be called so."""

    def files(self) -> list[tuple[str, int]]:
        """Names and sizes in bytes, in order."""

    def size(self, name: str) -> int:
        """Bytes; -1 where there is none of that name."""

    def open(self, name: str) -> IO[bytes]:
        """To be read."""

    def free_kb(self) -> int:
        """What still fits."""

    def delete(self, name: str) -> None:
        """Take one away."""

    def begin(self, name: str) -> IO[bytes]:
        """Where to write what is to be called so."""

    def append(self, file: IO[bytes], piece: bytes | bytearray) -> None:
        """Write the next piece."""

    def finish(self, name: str, file: IO[bytes], checksum: int) -> bool:
        """Have it take its place ; False where its CRC-32 is another: the old one stays."""

    def drop(self, name: str, file: IO[bytes]) -> None:
        """What has come is not wanted."""

class Card(Protocol):
    """A folder that can be taken out."""

    folder: str
    shared: array[int]  # with the supervisor, see ports/supervisor.py

    def mount(self) -> None:
        """Have what is in the holder now in its folder; OSError where that cannot be."""

    def unmount(self) -> None:
        """Forget what was known of it."""

    def check(self) -> None:
        """OSError where something could not be read or written since."""

class Options(Protocol):
    """What an extra's prepare() may have otherwise, before the machine is made."""

    axes: int
    kinematics: Kinematics | None  # None: each motor moves the axis of its own number
    settings: type[Settings]
    inputs: type[Inputs]
    homing_probing: type[HomingProbing]
    planner: type[Planner]
    canon: type[MachineCanon]
    report: type[Report]  # or one that speaks another dialect
    spindle: type[Spindle]  # or a tool that is told the same
    reads: tuple[int, int, int]  # talk/lines.py
    highest_tool: int
    line_length: int  # characters of a line
    rx_bytes: int  # that a sender may have under way
    defaults: dict[int, float]  # settings that differ from Grbl's
    custom: tuple[str, ...]  # the user's own modules
    job_files: JobFiles | None  # programs that live on the board
    driver_wire: DriverWire | None  # to motor drivers that have one

class Extra(Protocol):
    """A module of extras/, or a user's. It may have PINS: what it calls pins in the board file;
    and prepare(options, board), called before the machine is made."""

    def install(self, cnc: Cnc) -> None:
        """The machine is there: put around it what is to be otherwise."""

class Voice(Protocol):
    """What may be said from below: talk/report.py in the words of its dialect."""

    @property
    def send(self) -> Callable[[bytes | bytearray | memoryview], None]:
        """Write bytes as they are."""

    def message(self, text: str) -> None:
        """Something a person should know."""

    def alarm(self, code: int) -> None:
        """The machine had to stop."""

    def status(self) -> memoryview:
        """The answer to ?, to be sent before there is another."""

    def probe(self, probe: array[float]) -> None:
        """Where the probe touched last, mm, and whether it did."""

class Link(Protocol):
    """The sender: USB, UART, a pseudo-terminal, a test."""

    def read_into(self, buf: bytearray) -> int:
        """Move what has arrived into buf; return how many bytes. Never waits long."""

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Send; waits where the line is slower than we are."""

    def discard(self) -> None:
        """Drop what has arrived and has not been read."""

class BoardLink(Link, Protocol):
    """A Link of a real board: what power_up and the supervisor want besides."""

    shared: array[int]  # with the supervisor, see ports/supervisor.py
    check_supervisor: Callable[[], None]  # the supervisor's, called in the main loop, and raises
    is_slow: bool  # Ctrl-X is not heard before the main loop reads

    @property
    def poll_reset(self) -> Callable[[], int] | None:
        """Called by the supervisor, in its interrupt: whether a Ctrl-X has come. None where
        there is nothing to see but by reading."""

    def attach(self, at_rest: Callable[[], bool], on_open: Callable[[], None]) -> None:
        """Say when the REPL may be asked for, and who greets a sender that opens the port anew."""

    def close(self) -> None:
        """Leave all to MicroPython's prompt."""

class Access(Protocol):
    """Which callers may do more than read: ports/net/access.py."""

    secret: str  # who says it may

    def random_bytes(self, count: int) -> bytes:
        """So many bytes that nobody can guess."""

class Connection(Protocol):
    """One who has called over the network: MicroPython's socket, which never waits."""

    def readinto(self, buf: bytearray, /) -> int | None:
        """Move what has come into buf; None where nothing has, 0 where he has hung up."""

    def write(self, data: bytes | bytearray | memoryview, /) -> int | None:
        """Send as much as there is room for; None where there is none."""

    def close(self) -> None:
        """Hang up."""

class Incoming(Protocol):
    """Who calls over the network: ports/net/tcp.py."""

    def next(self) -> tuple[Connection, str] | None:
        """The next one, and his address; None where nobody calls."""

    def close(self) -> None:
        """Hear nobody any more."""

class Control(Protocol):
    """Who is in control of a machine on the network, as extras/net/net_access.py knows it."""

    ending: bool  # lines of another client are not done yet
    drop_half: Callable[[], None]  # the line that has begun is not wanted
    has_half: Callable[[], bool]  # one has begun

    def done(self) -> None:
        """They are."""

class NetworkLink(Link, Protocol):
    """A Link with the cable and a network, as extras/net/net_access.py knows it."""

    access: Access
    control: Control
    status: Callable[[], str]  # what the radio says

    def by_cable(self) -> bool:
        """Who drives sits at the cable."""

    def write_cable(self, data: bytes) -> None:
        """What nobody else is to read."""

    def client_count(self) -> int:
        """How many are connected."""

    def expel(self) -> None:
        """Hang up on all of them."""

class Store(Protocol):
    """Text lines kept over power-off, by name."""

    # What load() could not read the newest copy of; whether it has returned an older one.
    damaged: dict[str, bool]

    def load(self, name: str) -> list[str] | None:
        """No lines where there never were any under that name, None where they are lost."""

    def save(self, name: str, lines: Iterable[str]) -> None:
        """Replace at once or not at all."""
