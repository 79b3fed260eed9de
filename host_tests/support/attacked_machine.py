"""A machine at real sockets, under the desktop MicroPython: its cable's sender runs one job after
another, in virtual time, for SECONDS of real time.

micropython attacked_machine.py TCP_PORT HTTP_PORT PAGE_FOLDER KEY SECONDS

Prints a line of JSON: digests of the segments of each job, the longest turn of the link in us, the
most bytes that lwIP would have held, and whether a network client has held the last job.
"""

import hashlib
import json
import sys
import time
from array import array

from base import state
from motion.layout import ROW_AXES, ROW_STRIDE, ROW_TICKS
from ports.net.page import Page
from ports.net.page_link import PageLink
from ports.net.tcp import Calls
from sim.link import SimLink
from sim.replay import factory_store
from sim.rig import Rig

from boards import sim_page

_WINDOW = 120
# The first move is long enough to fill the planner before its end, whatever else happens.
_JOB = [b"G21G90G1X5F600\n", b"F2400\n"]
_JOB += [b"G1X%d.%dY%d\n" % (i % 5, i % 7, i % 3) for i in range(25)]
_JOB += [b"G1X0Y0\n", b"G2X4Y0I2\n", b"M3S500\n", b"G1X5Y3F900\n"]
_JOB += [b"G1X%dZ0.%d\n" % (i % 4, i % 2) for i in range(10)]
_JOB += [b"G1X0Y0Z0F2400\n", b"M5\n"]
_LAST_MS = 60_000


class Link(PageLink):
    """A network link with the attributes of the cable that a rig needs."""

    def __init__(self, rig, page):
        cable = SimLink(rig)
        cable.shared = array("i", (0, 0, 0))
        cable.poll_reset = None
        cable.is_slow = False
        PageLink.__init__(self, cable, page, "ugrbl")
        self.cable = cable
        self.page = page
        self.next_event = cable.next_event
        self.advance = cable.advance
        self.power_off = cable.power_off
        self.longest_us = self.most = 0
        self._at_rest = lambda: rig.controller.at_rest()  # noqa: PLW0108  (no controller yet)

    def read_into(self, buf):
        before = time.ticks_us()
        count = PageLink.read_into(self, buf)
        self.longest_us = max(self.longest_us, time.ticks_diff(time.ticks_us(), before))
        self.most = max(self.most, self._memory.held + self.page._memory.held)
        return count


def main(tcp, http, folder, key, seconds):
    store = factory_store(sim_page)
    store.files["settings"] += ["$%d=200" % number for number in (120, 121, 122)]
    store.files["network"] = ["KEY=" + key]
    page = Page(Calls(tcp), Calls(http), "ugrbl", folder)
    rig = Rig(sim_page, store, lambda rig: Link(rig, page))
    digests, held = [], []
    link = rig.link
    cable = link.cable

    def is_over():
        """Return whether a client holds the machine, or the wait has been long enough."""
        if rig.controller.state.run == state.HOLD:
            held.append(True)
        return held or time.ticks_diff(time.ticks_ms(), end) > _LAST_MS

    def run_job():
        cable.received = bytearray()
        yield (rig.now // rig.engine.tick_hz + 1) * rig.engine.tick_hz
        ends, done, sent = [0], 0, []
        digest = hashlib.sha256()

        def trace(start, row):
            made = list(row)
            for at in range(ROW_AXES, len(made), ROW_STRIDE):
                if not made[at]:  # no steps: the rest of the slot is stale
                    made[at : at + ROW_STRIDE] = [0] * ROW_STRIDE
            # The pause before a motion (at the start, for M3) depends on the main loop.
            digest.update(repr((start == ends[0], made)).encode())
            ends[0] = start + row[ROW_TICKS]

        rig.engine.trace = trace
        for line in _JOB:
            while sum(sent) + len(line) > _WINDOW:
                if is_over():
                    return
                yield rig.ms(1)
                answered = cable.received.count(b"ok\r\n")
                sent = sent[answered - done :]
                done = answered
            cable.send(line)
            sent.append(len(line))
        while not rig.controller.at_rest() or cable.received.count(b"ok\r\n") < len(_JOB):
            if is_over():
                return
            yield rig.ms(1)
        digests.append("".join("%02x" % byte for byte in digest.digest()[:8]))

    def script():
        while b"help]" not in cable.received:
            yield rig.ms(1)
        while time.ticks_diff(end, time.ticks_ms()) > 0:
            yield from run_job()
        print("last")  # from now on the machine waits for a hold
        while not held and time.ticks_diff(time.ticks_ms(), end) < _LAST_MS:
            yield from run_job()

    end = time.ticks_add(time.ticks_ms(), int(seconds * 1000))
    rig.run(script())
    print(json.dumps([digests, link.longest_us, link.most, bool(held)]))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3], sys.argv[4], float(sys.argv[5]))
