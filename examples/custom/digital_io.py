"""M62 to M68: outputs and inputs by numbers, as in LinuxCNC.

M62 P and M63 P switch an output on and off between the motion before them and the motion after
them, without a stop. M64 and M65 wait for motion to end first. M66 P L Q waits for an input, at
most Q seconds: L0 does not wait, L1 waits until it closes, L2 until it opens; L3 and L4 do the
same, and end at once if it is so already. M66 E reports the voltage of an analog input, from 0 to
1. M67 E Q and M68 E Q set a pulse width, Q from 0 to 1. Numbers count from 0, in the order of
these names of the board file and of the ADC's pins:
"""

from machine import ADC, Pin
from ugrbl import Refuse, mcode

OUTPUTS = ("air", "lamp", "fan")
INPUTS = ("part", "door")
ANALOG = (26, 27)
HZ = 1000  # pulses of M67 and M68


def named(names, number):
    if number not in range(len(names)):
        raise Refuse("P and E go from 0 to %d" % (len(names) - 1))
    return names[int(number)]


@mcode(62, "P", sync=False)
@mcode(64, "P")
def on(m, P):
    m.out(named(OUTPUTS, P), True)


@mcode(63, "P", sync=False)
@mcode(65, "P")
def off(m, P):
    m.out(named(OUTPUTS, P), False)


@mcode(66, "pelq")
def wait(m, P=None, E=None, L=0, Q=0):
    if (P is None) == (E is None) or (L and P is None):
        raise Refuse("M66: P, or E with L0")
    if P is None:
        voltage = ADC(Pin(named(ANALOG, E))).read_u16() / 65535
        m.message("M66 E%d: %.3f" % (E, voltage))
        return
    name = named(INPUTS, P)
    if L not in range(5) or (L and not Q):
        raise Refuse("M66: L is 0 to 4, and wants Q, the seconds to wait")
    closed = L in (1, 3)
    if L in (1, 2) and m.pin(name) == closed:  # an edge: wait for the other level first
        m.wait_for(name, not closed, Q)
    came = L == 0 or m.wait_for(name, closed, Q)
    m.message("M66 P%d: %s" % (P, int(m.pin(name)) if came else "nothing for %g s" % Q))


@mcode(67, "EQ", sync=False)
@mcode(68, "EQ")
def share(m, E, Q):
    m.pwm(named(OUTPUTS, E), Q, HZ)
