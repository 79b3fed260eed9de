"""Build a Pico whose core waits for flash: the model of its cache and its registers."""

from importlib.util import find_spec
from typing import Any

# Cycles the core waits for 4 bytes of flash: 20 clocks of the flash chip (8 for address and mode,
# 4 of silence, 8 for the bytes), each two clocks of the core, as the Pico's second stage of boot
# sets it (boot2_w25q080.S, PICO_FLASH_SPI_CLKDIV). Comparison with real boards: calibration.py.
MISS_CYCLES = 40

_XIP_CTRL = 0x14000000
_CTRL, _FLUSH, _CTR_HIT, _CTR_ACC = 0x00, 0x04, 0x0C, 0x10
_ENABLE = 1
_MOST = 0xFFFFFFFF


def is_there() -> bool:
    """Return whether the model (xip_cache.pyx) was compiled."""
    return find_spec("xip_cache") is not None


def chip() -> Any:
    """Return a maker of chips with the cache. Raise ImportError if it is not compiled."""
    from xip_cache import CachedChip

    def make(clock: object) -> Any:
        made = CachedChip(clock)
        made.cache.miss_cycles = MISS_CYCLES
        _connect(made)
        return made

    return make


def _connect(mcu: Any) -> None:
    """Connect the cache to its registers CTRL, FLUSH and counters, which rp2040py only stores."""
    cache, ctrl = mcu.cache, mcu.find_peripheral(_XIP_CTRL)
    read, write = ctrl.read_uint32, ctrl.write_uint32
    cleared = {_CTR_HIT: 0, _CTR_ACC: 0}

    def count(offset: int) -> int:
        return int(cache.hits + (cache.misses if offset == _CTR_ACC else 0))

    def read_uint32(offset: int) -> int:
        if offset in cleared:
            return min(count(offset) - cleared[offset], _MOST)
        return int(read(offset))

    def write_uint32(offset: int, value: int) -> None:
        if offset in cleared:
            cleared[offset] = count(offset)
        elif offset == _CTRL:
            cache.enabled = bool(value & _ENABLE)
        elif offset == _FLUSH and value & 1:
            cache.flush()
        write(offset, value)

    ctrl.read_uint32, ctrl.write_uint32 = read_uint32, write_uint32
