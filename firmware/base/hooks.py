"""Hooks: every place where an extra can take part, by name. Extras reach them by extras/api.py.

An extra that boot/select_extras.py names later is called later in an event, and is further out in
a chain. All hooks run in the main loop, except `next_segment`.

Two hooks are elsewhere because kernels call them: Planner.move_hook plans a line in another way,
and Block.read_on reads text that is not a word.
"""

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable

    from interfaces import NextSegment, Probe

    Power = Callable[[int, float], int]  # (flags, rpm): power
    Line = Callable[[bytearray, int], None]
    Calls = tuple[Callable[[], object], ...]
    Asks = tuple[Callable[[], bool], ...]


class Hooks:
    """A chain is one function: the machine's own until an extra replaces it by its own, which
    calls the previous one. An event is a tuple of functions, empty without extras, and then costs
    one test. An exception in one of them is raised in the machine."""

    # Chains. They may do whatever the machine's own function may do.
    execute: "Line"  # runs a line of G-code, which ends with a 0
    find_command: "Callable[[bytearray, int], Line]"  # returns what executes a $-line
    refuse: "Callable[[int], None]"  # reports an error to the sender, by Grbl's number
    alarm: "Callable[[int], None]"  # and an alarm
    forget: "Callable[[], None]"  # at each reset: the probed position, and what extras hold
    # Methods of HomingProbing.
    probe: "Probe"
    probed_at: "Callable[[], array[float]]"
    home: "Callable[[int], bool]"
    find_switches: "Callable[[int], None]"
    home_phase: "Callable[[int, bool, float, float], None]"
    write_offsets: "Callable[[int, array[float]], None]"  # see Coords.write()
    # Interrupt: fills a segment's row; see segments.py. Viper, because bytecode would need too
    # much stack.
    next_segment: "NextSegment"

    # The loop. They may wait, through Cnc.service().
    poll: "Calls" = ()  # after real-time commands, at each turn of every loop that waits
    between_lines: "Calls" = ()
    reset: "Calls" = ()  # after the welcome that follows power-up and every reset
    fields: "tuple[Callable[[], str], ...]" = ()  # of the status report; "" adds none
    build_info: "Calls" = ()  # after the answer to $I, before its "ok"
    # Lines.
    checked: "Calls" = ()  # a line is valid; GrblError refuses it before anything changes
    moved: "Calls" = ()  # a line's motion of G0 to G3 has been planned
    paused: "Asks" = ()  # M0: True takes it over, and must call Canon.hold_program() later
    ended: "Calls" = ()  # M2 or M30 has ended a program
    # A program has switched the spindle (direction, rpm) or coolant (a mask).
    spun: "tuple[Callable[[int, float], object], ...]" = ()
    cooled: "tuple[Callable[[int], object], ...]" = ()
    # Motion as a whole. They may neither move nor wait.
    may_start: "Asks" = ()  # before motion starts; False keeps the machine where it is
    started: "Calls" = ()
    stops: "Calls" = ()  # the engine has run out of work, or was stopped, even while idle
    waited: "Calls" = ()  # a wait for the end of all planned motion is over
    is_busy: "Asks" = ()  # True: the machine is not idle, though nothing moves
    # The planner.
    planned: "Calls" = ()  # chords of an arc have been added
    caught_up: "Calls" = ()  # everything that was added is planned
    replan: "Asks" = ()  # an override has changed; True: the extra has planned everything again
    cleared: "Calls" = ()  # all blocks have been dropped
    powered: "tuple[Callable[[Power], object], ...]" = ()  # see Planner.each_power()


def call_all(calls: "Calls") -> None:
    """Call each of an event's functions, in their order."""
    # A caller with little stack left first tests for an empty tuple: this loop is a function,
    # because in the caller's own frame it would take 24 bytes even then.
    for call in calls:
        call()


def all_agree(asks: "Asks") -> bool:
    """Return whether all of an event's functions return True. Stops at the first False."""
    for ask in asks:
        if not ask():
            return False
    return True
