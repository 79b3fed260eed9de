"""Numbers that senders know: errors, alarms and messages of Grbl 1.1h.

Each row's comment is its documentation; `make docs` puts it into docs/reference.md.
"""

from micropython import const

# Errors: the request was refused and nothing has changed.

# A word consists of a letter and a value; the letter was not found.
EXPECTED_COMMAND_LETTER = const(1)
# The value of a word, or of a setting, is missing or is not a number.
BAD_NUMBER_FORMAT = const(2)
# The '$' command was not recognised or is not supported.
INVALID_STATEMENT = const(3)
# A negative value was given where only a positive one makes sense.
NEGATIVE_VALUE = const(4)
# The homing cycle is not enabled ($22).
SETTING_DISABLED = const(5)
# The step pulse time ($0) must be 3 microseconds or more.
SETTING_STEP_PULSE_MIN = const(6)
# The stored settings could not be read; defaults were restored.
SETTING_READ_FAIL = const(7)
# The '$' command can only be used while the machine is idle, and not in check mode ($C).
IDLE_ERROR = const(8)
# G-code is locked out in alarm and during a jog.
SYSTEM_GC_LOCK = const(9)
# Soft limits ($20) need homing ($22).
SOFT_LIMIT_ERROR = const(10)
# The line is longer than the line buffer; it was not executed.
OVERFLOW = const(11)
# The setting asks for a step rate that the pulse engine cannot generate.
MAX_STEP_RATE_EXCEEDED = const(12)
# The safety door is open.
CHECK_DOOR = const(13)
# Build info or startup line is longer than the space for it.
LINE_LENGTH_EXCEEDED = const(14)
# The target of a jog is outside the machine's travel; the jog was ignored.
TRAVEL_EXCEEDED = const(15)
# A jog command has no '=' or has words that are not allowed in a jog.
INVALID_JOG_COMMAND = const(16)
# Laser mode needs a PWM output.
SETTING_DISABLED_LASER = const(17)
# The block has a word that is not supported or not valid here.
GCODE_UNSUPPORTED_COMMAND = const(20)
# Two words of the same modal group are in one block.
GCODE_MODAL_GROUP_VIOLATION = const(21)
# The feed rate has not been set, or is not defined in this mode.
GCODE_UNDEFINED_FEED_RATE = const(22)
# A G or M word needs a whole number.
GCODE_COMMAND_VALUE_NOT_INTEGER = const(23)
# Two words in one block both need the axis words.
GCODE_AXIS_COMMAND_CONFLICT = const(24)
# A word is repeated in the block.
GCODE_WORD_REPEATED = const(25)
# The command needs axis words, and the block has none.
GCODE_NO_AXIS_WORDS = const(26)
# The line number is out of range.
GCODE_INVALID_LINE_NUMBER = const(27)
# The command needs a value word (P, L …) that is not there.
GCODE_VALUE_WORD_MISSING = const(28)
# The work coordinate system does not exist: there are six, G54 to G59.
GCODE_UNSUPPORTED_COORD_SYS = const(29)
# G53 is allowed with G0 and G1 only.
GCODE_G53_INVALID_MOTION_MODE = const(30)
# The block has axis words that no command uses.
GCODE_AXIS_WORDS_EXIST = const(31)
# An arc needs an axis word in its plane.
GCODE_NO_AXIS_WORDS_IN_PLANE = const(32)
# The target of the motion is not valid: the arc is impossible, or the probe is already there.
GCODE_INVALID_TARGET = const(33)
# No arc of that radius reaches the target.
GCODE_ARC_RADIUS_ERROR = const(34)
# An arc by centre needs an offset word (I, J, K) in its plane.
GCODE_NO_OFFSETS_IN_PLANE = const(35)
# The block has a value word that no command uses.
GCODE_UNUSED_WORDS = const(36)
# G43.1 accepts the tool length axis and no other.
GCODE_G43_DYNAMIC_AXIS_ERROR = const(37)
# The tool number is greater than 255.
GCODE_MAX_VALUE_EXCEEDED = const(38)

# Alarms: the machine had to stop; G-code is locked until $X or $H.

# A limit switch was hit. The machine's position is probably lost: home it again.
ALARM_HARD_LIMIT = const(1)
# A motion would leave the machine's travel. The position is still valid.
ALARM_SOFT_LIMIT = const(2)
# Reset while moving: steps may have been lost.
ALARM_ABORT_CYCLE = const(3)
# The probe was not in the expected state when the probing cycle began.
ALARM_PROBE_FAIL_INITIAL = const(4)
# The probe touched nothing within the programmed travel.
ALARM_PROBE_FAIL_CONTACT = const(5)
# Homing failed: reset during the cycle.
ALARM_HOMING_FAIL_RESET = const(6)
# Homing failed: the safety door was opened.
ALARM_HOMING_FAIL_DOOR = const(7)
# Homing failed: a switch stayed closed after the pull-off ($27).
ALARM_HOMING_FAIL_PULLOFF = const(8)
# Homing failed: no switch was found within the search distance.
ALARM_HOMING_FAIL_APPROACH = const(9)
# Homing failed: the second switch of an axis was not found in time.
ALARM_HOMING_FAIL_DUAL_APPROACH = const(10)
# The firmware found an internal fault and stopped the machine. Not one of Grbl's.
ALARM_INTERNAL = const(16)
# The emergency stop was pressed. Not one of Grbl's.
ALARM_EMERGENCY_STOP = const(17)
# A handler of the user's own has failed: the message before it names file and line. The position
# is still valid. Not one of Grbl's.
ALARM_HANDLER = const(34)
# A motor driver is hot, damaged, without supply, or does not answer: the message before it says
# which. The machine's position is probably lost. Not one of Grbl's.
ALARM_DRIVER = const(35)

# Messages, as sent in [MSG:…]. None may contain "ok" or "error".
MSG_CRITICAL_EVENT = "Reset to continue"
MSG_ALARM_LOCK = "'$H'|'$X' to unlock"
MSG_ALARM_UNLOCK = "Caution: Unlocked"
MSG_ENABLED = "Enabled"
MSG_DISABLED = "Disabled"
MSG_DOOR_AJAR = "Check Door"
MSG_CHECK_LIMITS = "Check Limits"
MSG_EMERGENCY_STOP = "Emergency stop"
MSG_PROGRAM_END = "Pgm End"
MSG_RESTORE_DEFAULTS = "Restoring defaults"
MSG_SPINDLE_RESTORE = "Restoring spindle"
MSG_SLEEP = "Sleeping"
MSG_FIRST_START = "First start: factory settings"
MSG_NOT_KEPT = "Flash is full or worn: not saved"
MSG_DAMAGED = "Damaged in flash: %s (%s)"

# Identifies the build: `ugrbl build` writes it here.
BUILD_ID = "--------"


class GrblError(Exception):
    """The request is refused; nothing has changed. The sender sees error:<code>."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class Abort(Exception):
    """A soft reset unwinds every wait. The sender sees the banner."""
