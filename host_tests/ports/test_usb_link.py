"""The link over USB without MicroPython's ring, as a port has it that is none of ours: answers go
out whole and in their order, however long. With the ring the emulated Pico has it (emulator/)."""

from micropython_runner import needs_micropython, run_micropython
from ugrbl.paths import FIRMWARE

_SCRIPT = """
from ports.usb.usb_link import UsbLink

link = UsbLink()
buf = bytearray(64)
for text in (b"ok", b"<Idle|MPos:0.000>", b"x" * 700, b"ok", b"y" * 90):
    link.write(text + b"\\r\\n")
for _ in range(8):
    link.read_into(buf)
"""


@needs_micropython
def test_answers_go_out_whole_and_in_their_order() -> None:
    said = run_micropython(_SCRIPT, paths=[FIRMWARE]).split()
    assert said == ["ok", "<Idle|MPos:0.000>", "x" * 700, "ok", "y" * 90]
