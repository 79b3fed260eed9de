"""Pick and place with a suction cup: M116 Z-12 picks at that height, M117 Z-10 places.

OUTPUTS = {"vacuum": 20, "blow": 21}, INPUTS = {"gripped": 22} in the board file. "gripped" is the
vacuum sensor. If a part is lost on the way, the machine holds.
"""

from ugrbl import Refuse, mcode, on

GRIP_S, BLOW_S = 0.8, 0.15
SLOW = 600  # mm/min, down to the part


def go(m, word, z):
    with m.saved():
        m.g("%s Z%.3f F%d" % (word, z, SLOW))
        m.wait_motion()


@mcode(116, "Z")
def pick(m, Z):
    if m.pin("gripped"):
        raise Refuse("M116: there is a part at the sucker already")
    top = m.work().z
    m.out("vacuum", True)
    while True:
        go(m, "G1", m.mm(Z))
        m.wait_for("gripped", seconds=GRIP_S)
        go(m, "G0", top)
        if m.pin("gripped"):
            return
        m.ask("No part at the sucker: put one there, then cycle start")


@mcode(117, "Z")
def place(m, Z):
    top = m.work().z
    go(m, "G1", m.mm(Z))
    m.out("vacuum", False)
    m.out("blow", True)
    m.wait(BLOW_S)
    m.out("blow", False)
    go(m, "G0", top)


@on.input("gripped")
def changed(m, closed):
    if not closed and m.is_on("vacuum") and m.state == "Run":
        m.hold()
        m.message("The part is lost: put it back, then cycle start, or reset")
