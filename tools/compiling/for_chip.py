"""Leave code that only one of two chips needs out of the firmware for the other.

`RP2350 = const(1)` in pio/state_layout.py says that the chip may be an RP2350. For a processor
that is in an RP2040 and in no RP2350 it becomes 0, and the compilers drop the code that depends on
it.
"""

import re
from collections.abc import Mapping

from ..boardfile.chips import processors

_MODULE = "pio.state_layout"
_CHIP = "RP2350"
_MAY_BE = re.compile(rf"^{_CHIP} = const\(1\)$", re.MULTILINE)


def for_chip(sources: Mapping[str, str], arch: str) -> dict[str, str]:
    """Return the modules, by name, for the chips with this processor. ValueError if the line with
    the constant is missing."""
    made = dict(sources)
    if _CHIP not in processors(arch):
        made[_MODULE], count = _MAY_BE.subn(f"{_CHIP} = const(0)", made[_MODULE])
        if count != 1:
            raise ValueError(f"{_MODULE} does not say whether the chip may be an {_CHIP}")
    return made
