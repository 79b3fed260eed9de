"""Parts of an ESP32 board: its engines, under the names that parts.py uses."""

from esp_chip.pins import EspPort
from esp_chip.start import prepare
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType

    from esp_chip.i2s import I2sEngine
    from esp_chip.rmt import RmtEngine
    from interfaces import BoardLink


def rmt(board: "ModuleType", link: "BoardLink") -> "tuple[RmtEngine, EspPort]":
    """Create the RMT engine and its port. Raises MemoryError if memory is short."""
    prepare()  # sets the clock and checks memory, before compiled code is loaded
    from esp_chip.rmt import RmtEngine

    engine = RmtEngine(board.STEP, board.DIR)
    port = EspPort(board)
    _join(engine, port, link)
    return engine, port


def i2s(board: "ModuleType", link: "BoardLink") -> "tuple[I2sEngine, EspPort]":
    """Create the I2S engine and its port. Raises MemoryError if memory is short."""
    prepare()  # sets the clock and checks memory, before compiled code is loaded
    from esp_chip.i2s import I2sEngine

    engine = I2sEngine(
        board.STEP, board.DIR, board.ENABLE, board.I2S, board.I2S_RATE_HZ, board.I2S_BUFFERS
    )
    port = EspPort(board, engine.enable)  # a shift register's output enables the motors
    _join(engine, port, link)
    return engine, port


def _join(engine: "RmtEngine | I2sEngine", port: EspPort, link: "BoardLink") -> None:
    """Connect engine, port and link: engine and link poll the inputs, because pin interrupts may
    be late on this chip; a fault of the engine switches the tool off."""
    engine.on_poll = port.poll_inputs
    link.on_poll = port.poll_inputs  # type: ignore[attr-defined]  # UartLink's
    engine.on_fault = port.kill
