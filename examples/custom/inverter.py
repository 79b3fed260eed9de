"""A spindle on an inverter with RS-485: M3, M4 and M5 wait until it has reached its speed.

Modbus, registers of a Delta VFD-EL, a motor with two poles, UART 1 on GP8 and GP9. The RS-485
module must switch direction by itself. Also wire SPINDLE_ON to the inverter's enable input: it
switches off at once, whatever this program does. Overrides of S are not passed on.
"""

from machine import UART, Pin
from ugrbl import every, on

CONTROL, FREQUENCY, OUTPUT = 0x2000, 0x2001, 0x2103  # the last two in 0.01 Hz
WORDS = {"M3": 0x12, "M4": 0x22, "M5": 0x01}
WRITE, READ = 6, 3
PATIENCE_S, MISSES = 15, 5

bus = UART(1, baudrate=19200, tx=Pin(8), rx=Pin(9))
outbox = []
speed = {"wanted": 0, "is": 0, "misses": 0}  # rpm


def send(function, register, value):
    frame = bytes((1, function, register >> 8, register & 255, value >> 8, value & 255))
    crc = 0xFFFF
    for byte in frame:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    bus.write(frame + bytes((crc & 255, crc >> 8)))


@every(50)
def talk(m):
    answer = bus.read() or b""
    speed["misses"] = 0 if answer else speed["misses"] + 1
    if answer[:3] == b"\x01\x03\x02" and len(answer) == 7:
        speed["is"] = (answer[3] << 8 | answer[4]) * 60 // 100
    send(*outbox.pop(0) if outbox else (READ, OUTPUT, 1))
    if speed["wanted"] and speed["misses"] > MISSES:
        m.stop("The inverter does not answer")


@on.spindle
def turn(m, word, rpm):
    speed["wanted"] = wanted = 0 if word == "M5" else int(rpm)
    outbox[:] = [(WRITE, FREQUENCY, wanted * 100 // 60), (WRITE, CONTROL, WORDS[word])]
    for _ in range(PATIENCE_S * 10):
        m.wait(0.1)
        if not outbox and abs(speed["is"] - wanted) <= 30 + wanted // 50:
            return
    m.stop("The spindle has %d rpm and should have %d" % (speed["is"], wanted))


@on.alarm
@on.after_reset
def stop(m, number=0):
    speed["wanted"] = 0
    outbox[:] = [(WRITE, CONTROL, WORDS["M5"])]
