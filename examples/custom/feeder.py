"""A feeder that waits for its sensor: M115, or M115 Q20 for at most 20 s.

OUTPUTS = {"feeder": 20}, INPUTS = {"part": 21, "jam": 22} in the board file. The job waits until a
part lies still at the sensor. If no part comes, the job holds and asks for help.

Checked by: ugrbl custom check feeder.py --input part=500ms
"""

from ugrbl import Refuse, mcode

STILL_S = 0.3


def one_part(m, seconds):
    """Run the feeder until a part comes; return False if none has come."""
    m.out("feeder", True)
    try:
        return m.wait_for("part", seconds=seconds)
    finally:
        m.out("feeder", False)


@mcode(115, "q")
def feed(m, Q=10):
    if not 0 < Q <= 120:
        raise Refuse("M115: Q is seconds, up to 120, not %g" % Q)
    if m.pin("jam"):
        raise Refuse("M115: the feeder is jammed")
    while True:
        if one_part(m, Q) and not m.wait_for("part", closed=False, seconds=STILL_S):
            return
        m.ask("No part within %g s: see to the feeder, then cycle start" % Q)
