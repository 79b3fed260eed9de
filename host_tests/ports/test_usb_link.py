"""The USB link without MicroPython's ring, as on other ports: answers go out complete and in
order, at any length. The emulated Pico tests it with the ring (emulator/)."""

from micropython_runner import needs_micropython, run_micropython
from ugrbl.paths import FIRMWARE

_SCRIPT = """
from ports.usb.usb_link import UsbLink

link = UsbLink()
buf = bytearray(64)
for text in (b"ok", b"<Idle|MPos:0.000>", b"x" * 700, b"ok", b"y" * 90):
    link.write(text + b"\\r\\n")
for _ in range(8):
    link.read_into(buf)  # sends answers that wait
"""


@needs_micropython
def test_answers_go_out_complete_and_in_order() -> None:
    sent_lines = run_micropython(_SCRIPT, paths=[FIRMWARE]).split()
    assert sent_lines == ["ok", "<Idle|MPos:0.000>", "x" * 700, "ok", "y" * 90]
