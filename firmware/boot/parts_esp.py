"""Parts of an ESP32 board: what parts.py makes there."""

from esp_chip.pins import EspPort
from esp_chip.start import prepare
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType

    from esp_chip.i2s import I2sEngine
    from esp_chip.rmt import RmtEngine
    from interfaces import BoardLink

# Modules with compiled code, the largest first.
_COMPILED = (
    "motion.segment_kernel motion.plan_kernel language.words talk.lines talk.digits motion.steps "
    "motion.ramps motion.reals talk.singles motion.planner control.canon talk.protocol "
    "language.fast_path"
)


def make(board: "ModuleType", link: "BoardLink") -> "tuple[RmtEngine | I2sEngine, EspPort]":
    """Engine and port; all three work together. Raises MemoryError where compiled code finds no
    room."""
    prepare(_COMPILED.split())
    engine: "RmtEngine | I2sEngine"
    if board.ENGINE == "rmt":
        from esp_chip.rmt import RmtEngine

        engine = RmtEngine(board.STEP, board.DIR)
        port = EspPort(board)
    else:
        from esp_chip.i2s import I2sEngine

        engine = I2sEngine(
            board.STEP, board.DIR, board.ENABLE, board.I2S, board.I2S_RATE_HZ, board.I2S_BUFFERS
        )
        port = EspPort(board, engine.enable)
    engine.on_look = port.look
    link.on_turn = port.look  # type: ignore[attr-defined]  # UartLink's
    engine.on_fault = port.kill
    return engine, port
