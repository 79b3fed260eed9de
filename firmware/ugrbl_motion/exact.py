# mypy: disable-error-code=arg-type
"""Exact rates: a row's time is set to what the program asked for, without an error that adds up.

The planner's speeds are reals with an error of 2**-14, because they only decide when a step comes.
That is five seconds a day, and a telescope sees it. So each block has, in the place of the
line number, the ticks between two steps of its longest axis at the speed asked for: the bits of a
single-precision float, or 0. A row at about that speed gets exactly that time; the remainder below
a tick goes into the next row. Ramps, holds and other speeds are far enough off to be left alone.
"""

import micropython
from micropython import const
from motion.layout import (
    BLOCK_AT,
    CRUISE,
    LINE,
    ROW_AXES,
    ROW_STRIDE,
    ROW_TICKS,
)
from motion.segment_kernel import fill
from motion.segments import Segments

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array

    from motion.planner import Planner

_FRACTION_BITS = const(17)  # of a tick; 4095 steps of less than a tick fit 29 bits
_NEAR_LOG2 = const(10)  # 2**-10 of a row; the planner's own error is below half of that
_END_LOG2 = const(6)  # 2**-6 step: each end may be 2**-7 off (slice_kernel.STEP_BIAS)


@micropython.viper
def set_time(flow: ptr32, ring: ptr32, row: ptr32, motors: int, rest: ptr32) -> int:
    """Give a row at about the block's exact rate exactly its time. Returns 1 if that was done, 0
    if the row has another rate (a ramp, a hold), or its block no exact one.

    flow, ring: the planner's; row: just made, of the loaded block; motors: their number. rest[0]:
    fraction of a tick that is due, in 2**-17. A slow block's speed is a small number (CRUISE), so
    its error may be larger. Steps keep their places within the row, in proportion.
    """
    at = flow[BLOCK_AT]  # index of the loaded block in the ring
    bits = ring[at + LINE]  # ticks per step at the exact rate, a float; 0: it has none
    steps = 0  # of the motor that makes the most in this row
    for i in range(motors):
        if row[ROW_AXES + ROW_STRIDE * i] > steps:
            steps = row[ROW_AXES + ROW_STRIDE * i]
    if bits == 0 or steps == 0:
        return 0
    # Ticks per step = mantissa (24 bits) * 2**-shift = whole ticks, and a fraction in 2**-17.
    shift = 150 - (bits >> 23)  # 150: the exponent's bias, 127, and the 23 bits stored
    mantissa = (bits & 0x7FFFFF) | 0x800000  # the highest bit is not stored
    fraction = 0
    if shift > 0:
        whole = mantissa >> shift
        fraction = mantissa - (whole << shift)
        if shift > _FRACTION_BITS:
            fraction >>= shift - _FRACTION_BITS
        else:
            fraction <<= _FRACTION_BITS - shift
    else:
        whole = mantissa << (0 - shift)
    ticks = row[ROW_TICKS]  # the row's time, as planned
    fraction = fraction * steps + rest[0]  # of the whole row from here on
    exact = whole * steps + (fraction >> _FRACTION_BITS)  # the time that the row is to have
    change = exact - ticks
    if change < 0:  # without a sign from here on: exact > ticks says which way
        change = 0 - change
    near = (ticks >> _NEAR_LOG2) + (whole >> _END_LOG2)  # the planner's errors, in ticks
    rounding = ticks // ((ring[at + CRUISE] >> 1) + 1) + 2  # of CRUISE to a whole number
    if change > near + rounding:  # more than errors: a ramp or a hold
        return 0
    rest[0] = fraction & ((1 << _FRACTION_BITS) - 1)
    row[ROW_TICKS] = exact
    scale = 0  # so that the products below fit: the times of steps need no more than 12 bits
    while ticks >> scale >= 4096:
        scale += 1
    for i in range(motors):
        base = ROW_AXES + ROW_STRIDE * i  # its steps; the ticks of the first and the last follow
        end = base + 3 if row[base] else base + 1  # without steps it has no ticks
        for k in range(base + 1, end):
            shift_ticks = (row[k] >> scale) * change // (ticks >> scale)  # change * tick / ticks
            row[k] = row[k] + shift_ticks if exact > ticks else row[k] - shift_ticks
    return 1


class ExactSegments(Segments):
    """Segments with exact rates. rest: an array of one integer, for set_time()."""

    def __init__(self, planner: "Planner", rest: "array[int]") -> None:
        super().__init__(planner)
        self._motors = planner.motors
        self._rest = rest

    @micropython.viper
    def next(self, row: ptr32) -> int:
        """Fill in the next segment's row, as Segments.next() does, at its exact rate. Returns 0 if
        no motion is due, else 1."""
        flow = ptr32(self._flow_at)
        ring = ptr32(self._ring_at)
        table = ptr32(self._table_at)
        if int(fill(flow, ring, table, row)) == 0:  # as Segments.next()
            return 0
        set_time(flow, ring, row, int(self._motors), ptr32(self._rest))
        return 1
