"""A pen on a servo: M3 puts it down, M5 lifts it, and both wait until the servo has arrived.

GP15 makes the servo's pulses, so the board file must not use it. GP14 must not be the spindle's
PWM, because both pins share one frequency. Every stop of the machine lifts the pen.
"""

from machine import PWM, Pin
from ugrbl import on

UP_US, DOWN_US = 1000, 1600  # pulses: measure yours
DOWN_S, UP_S = 0.15, 0.10  # the servo's travel times; the pen takes longest to fall

servo = PWM(Pin(15), freq=50, duty_u16=0)
now_us = 0


def turn(us):
    """Move the servo; return whether its position changes."""
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
