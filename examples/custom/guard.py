"""A guard for a touch probe: M114 P1 while one is in the spindle, M114 P0 without.

If the probe touches anything outside a probing move, the machine stops with ALARM:34 and keeps its
position. It stops within the probe's give if rapids are slow enough for that: $110 and $120. Then
unlock, and jog away. While the guard is on the spindle does not turn.
"""

from ugrbl import Refuse, every, mcode, on

CLEAR_MS = 10  # contacts bounce when the probe leaves a surface

clear = 0


@mcode(114, "P")
def guard(m, P):
    if P and "M5" not in m.modes():
        raise Refuse("M114: the spindle turns")
    m.keep["guard"] = int(P)


@every(1)
def watch(m):
    global clear
    if not m.touches():
        clear += 1
        return
    was_clear, clear = clear >= CLEAR_MS, 0
    if was_clear and m.keep.get("guard") and m.state in ("Run", "Jog") and not m.probing():
        m.stop("The probe has run into something at %s" % m.position())


@on.spindle
def no_spindle(m, word, rpm):
    if word != "M5" and m.keep.get("guard"):
        m.stop("%s with a probe in the spindle: M114 P0 first" % word)
