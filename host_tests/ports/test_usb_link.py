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


_BYTE_AFTER_DOLLAR = """
from ports.link_memory import DOLLAR_WAITS
from ports.usb.usb_link import UsbLink

link = UsbLink()
link.shared[DOLLAR_WAITS] = 1  # $F<=A.NC is being answered, with pieces of a file
for text in (b"a" * 128, b"b", b"\\r\\n", b"ok\\r\\n"):
    link.write(text)
link.read_into(bytearray(64))
link.read_into(bytearray(64))
link.read_into(bytearray(64))
"""


@needs_micropython
def test_single_byte_of_an_answer_to_a_dollar_is_sent() -> None:
    sent_lines = run_micropython(_BYTE_AFTER_DOLLAR, paths=[FIRMWARE]).split()
    assert sent_lines == ["a" * 128 + "b", "ok"]
