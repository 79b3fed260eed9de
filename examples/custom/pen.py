"""A pen at a servo: M3 puts it down, M5 lifts it, and both wait until the servo is there.

GP15 makes the servo's pulses; the board file leaves that pin alone, and its neighbour GP14 is no
spindle's (they share a frequency). Whatever stops the machine lifts the pen.
"""

from machine import PWM, Pin
from ugrbl import on

UP_US, DOWN_US = 1000, 1600  # pulses: measure yours
DOWN_S, UP_S = 0.15, 0.10  # so long the servo is on its way; a pen falls last of all

servo = PWM(Pin(15), freq=50, duty_u16=0)
now_us = 0


def turn(us):
    """Returns whether that is another place."""
    global now_us
    was_us, now_us = now_us, us
    servo.duty_u16(us * 65535 // 20000)
    return us != was_us


@on.spindle
def pen(m, word, rpm):
    is_down = word != "M5"
    if turn(DOWN_US if is_down else UP_US):
        m.wait(DOWN_S if is_down else UP_S)


@on.alarm
def lift_in_alarm(m, number):
    turn(UP_US)


@on.startup
@on.after_reset
def lift(m):
    turn(UP_US)
