"""Hooks: every place where an extra may have its say, by name. Extras reach them by extras/api.py.

Who is named later in boot/select_extras.py is called later in an event, and stands further out in
a chain. All is of the main loop, but for `next_segment`.

Two are not here, for kernels call them: Planner.move_hook plans a line in another way, and
Block.read_on reads what is no word.
"""

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable

    from interfaces import NextSegment, Probe

    Power = Callable[[int, float], int]  # of flags and rpm
    Line = Callable[[bytearray, int], None]
    Calls = tuple[Callable[[], object], ...]
    Asks = tuple[Callable[[], bool], ...]


class Hooks:
    """Chains hold one function, the machine's own until an extra puts its own there, which calls
    the one that was there before. Events hold as many as there are, none on a plain board: that
    costs a look at an empty tuple. What raises in one, raises in the machine."""

    # Chains. They may do whatever that function may.
    execute: "Line"  # a line of G-code, which a 0 follows
    find_command: "Callable[[bytearray, int], Line]"  # who executes a line that begins with $
    refuse: "Callable[[int], None]"  # tells the sender of an error, by Grbl's number
    alarm: "Callable[[int], None]"  # and of an alarm
    probe: "Probe"  # see Seek
    probed_at: "Callable[[], array[float]]"
    forget_probe: "Callable[[], None]"
    home: "Callable[[int], bool]"
    find_switches: "Callable[[int], None]"
    home_phase: "Callable[[int, bool, float, float], None]"
    write_offsets: "Callable[[int, array[float]], None]"  # see Coords.write()
    # Interrupt: fills a segment's row; see segments.py. Viper, or it would need too much stack.
    next_segment: "NextSegment"

    # The loop. They may wait, by Cnc.service().
    poll: "Calls" = ()  # after real-time commands, at each turn of every loop that waits
    between_lines: "Calls" = ()
    reset: "Calls" = ()  # after the welcome that follows power-up and every reset
    fields: "tuple[Callable[[], str], ...]" = ()  # of the status report; "" is none
    build_info: "Calls" = ()  # $I has been answered, but for its "ok"
    # Lines.
    checked: "Calls" = ()  # one is right, and GrblError refuses it: nothing has changed
    moved: "Calls" = ()  # one has asked for a motion of G0 to G3, which has been planned
    paused: "Asks" = ()  # M0: True takes it over, to call Canon.hold_program() later
    ended: "Calls" = ()  # M2 or M30 has ended a program
    # A program has turned the spindle (direction, rpm) and switched coolant (a mask).
    spun: "tuple[Callable[[int, float], object], ...]" = ()
    cooled: "tuple[Callable[[int], object], ...]" = ()
    # Motion as a whole. May neither move nor wait.
    may_start: "Asks" = ()  # before it begins; False keeps the machine where it is
    started: "Calls" = ()
    stops: "Calls" = ()  # the engine has nothing left to do, or has been stopped; at rest, too
    waited: "Calls" = ()  # somebody has waited for the end of all that was planned
    is_busy: "Asks" = ()  # True: the machine is not at rest, though nothing moves
    # The planner.
    planned: "Calls" = ()  # chords of an arc have been added
    caught_up: "Calls" = ()  # all is planned that was added
    replan: "Asks" = ()  # an override has changed: True has planned all anew
    cleared: "Calls" = ()  # all is forgotten
    powered: "tuple[Callable[[Power], object], ...]" = ()  # see Planner.each_power()


def call_all(calls: "Calls") -> None:
    """Call them all. Callers with little stack left test for an empty tuple first: a loop in their
    own frame would take 24 bytes even then."""
    for call in calls:
        call()


def all_agree(asks: "Asks") -> bool:
    """Whether all of them say yes. The first no ends it."""
    for ask in asks:
        if not ask():
            return False
    return True
