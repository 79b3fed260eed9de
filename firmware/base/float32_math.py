# mypy: disable-error-code=arg-type
"""Single precision with integers only: positions as Grbl computes them, in viper kernels.

A MicroPython float is an object on the heap, and creating one takes longer than a function here.
Floats are therefore read and written as their bits: sign, 8 bits of exponent (bias 127), 23 bits
of mantissa, with a leading 1 that is not stored. An array of floats is passed as ptr32; its float
i has its sign bit in byte 4 * i + 3. An exponent of 255 is infinite, one of 0 is the number 0.
"""

import micropython
from micropython import const

MINUS = const(128)  # the sign bit, in the last byte of a float
SMALL = const(0x2000000)  # of mantissa_product(): the exponent is one less
_FRACTION = const(0x7FFFFF)  # the stored bits of a mantissa
_LEADING = const(0x800000)  # its leading 1
_HALF = const(0x800000)  # half a unit, in 24 bits of fraction
# 30 bits: the widest mask that is not an object on a board.
_MAGNITUDE = const(0x3FFFFFFF)  # all but sign and bit 30
# The exponent of number / divisor, less the divisor's: 150, of a whole number of 24 bits, + bias.
_WHOLE_EXPONENT = const(277)  # 150 + 127


@micropython.viper
def mantissas(number: int, divisor: int) -> int:
    """Return the mantissa of number / divisor, both of 24 bits, rounded to even; 24 bits or 2**24.

    number / divisor must be from 1 to 2. Long division of what is above 1: four digits of 7 bits,
    so that a remainder << 7 has 31 bits.
    """
    remainder = number - divisor
    result = 1  # the digit above the point
    for _ in range(4):
        remainder <<= 7
        digit = remainder // divisor
        result = (result << 7) + digit
        remainder -= digit * divisor
    # The result has 29 bits, five more than a mantissa, which are rounded off. A remainder sets
    # the lowest one, so that a half is not exact; an exact half (16) is rounded up only if the bit
    # above it is set.
    if remainder:
        result |= 1
    return (result + 15 + ((result >> 5) & 1)) >> 5


@micropython.viper
def mantissa_product(number: int, factor: int) -> int:
    """Return the mantissa of number * factor, both of 24 bits, rounded to even; 24 bits or 2**24,
    and SMALL if the product of the two, as numbers from 1 to 2, is less than 2.

    Halves of 12 bits, so that all products fit 32 bits: number becomes the upper 24 of the 48
    bits, low the lower ones, which are a fraction and rounded off.
    """
    middle = (number >> 12) * (factor & 0xFFF) + (number & 0xFFF) * (factor >> 12)
    low = (number & 0xFFF) * (factor & 0xFFF) + ((middle & 0xFFF) << 12)
    number = (number >> 12) * (factor >> 12) + (middle >> 12) + (low >> 24)
    low &= 0xFFFFFF
    small = 0
    if number < _LEADING:  # the product has 47 bits: keep one more
        number = (number << 1) | (low >> 23)
        low = (low << 1) & 0xFFFFFF
        small = SMALL
    if low > _HALF or (low == _HALF and number & 1):
        number += 1
    return number | small


@micropython.viper
def divide(numbers: ptr32, divisors: ptr32, at: int, quotients: ptr32, count: int) -> int:
    """Set quotients[i] to numbers[i] / divisors[at + i], for count axes.

    Numbers are whole, of 30 bits, and become floats first; divisors are floats above 0. Results
    are rounded to the nearest, halves to even.
    """
    for i in range(count):
        number = numbers[i]
        sign = ptr8(numbers)[4 * i + 3] & MINUS
        if sign:
            number = 0 - number
        number &= _MAGNITUDE  # 30 bits: so the loops below end for any number
        quotients[i] = 0
        if number:
            # Round to 24 bits, halves to even: the number is then number * 2**exponent.
            exponent = 0
            while number >> exponent >= 1 << 24:
                exponent += 1
            if exponent:
                number += (1 << (exponent - 1)) - 1 + ((number >> exponent) & 1)
                number >>= exponent
            divisor = divisors[at + i]
            exponent += _WHOLE_EXPONENT - (divisor >> 23)  # a divisor has no sign bit
            divisor = (divisor & _FRACTION) | _LEADING
            while number < divisor:  # mantissas() needs a quotient of 1 or more
                number <<= 1
                exponent -= 1
            store(quotients, i, int(mantissas(number, divisor)), exponent, sign)
    return 0


@micropython.viper
def multiply(values: ptr32, at: int, factors: ptr32, of: int) -> int:
    """Multiply values[at] by factors[of], both floats as bits. Rounds to even. Returns 0."""
    exponent = (values[at] >> 23) & 255
    if exponent == 0:
        return 0
    other_exponent = (factors[of] >> 23) & 255
    if other_exponent == 0:
        exponent = 0  # a factor of 0: with that, store() makes the product 0, too
    # The sum of exponents has the bias, 127, twice. 1 more, because without SMALL the product is
    # from 2 to 4, and mantissa_product() returns half of it.
    exponent += other_exponent - 126
    sign = (ptr8(values)[4 * at + 3] ^ ptr8(factors)[4 * of + 3]) & MINUS
    factor = (factors[of] & _FRACTION) | _LEADING
    number = int(mantissa_product((values[at] & _FRACTION) | _LEADING, factor))
    if number & SMALL:
        number ^= SMALL
        exponent -= 1
    return int(store(values, at, number, exponent, sign))


@micropython.viper
def quotient(values: ptr32, at: int, divisors: ptr32, of: int) -> int:
    """Divide values[at] by divisors[of], which is not 0, both floats as bits. Rounds to even.
    Returns 0."""
    exponent = (values[at] >> 23) & 255
    if exponent == 0:
        return 0
    sign = (ptr8(values)[4 * at + 3] ^ ptr8(divisors)[4 * of + 3]) & MINUS
    exponent += 127 - ((divisors[of] >> 23) & 255)  # the difference, with the bias again
    number = (values[at] & _FRACTION) | _LEADING
    divisor = (divisors[of] & _FRACTION) | _LEADING
    if number < divisor:  # mantissas() needs a quotient of 1 or more
        number <<= 1
        exponent -= 1
    return int(store(values, at, int(mantissas(number, divisor)), exponent, sign))


@micropython.viper
def store(values: ptr32, at: int, number: int, exponent: int, sign: int) -> int:
    """Store a mantissa (24 bits, or 2**24 after rounding), exponent (with bias) and sign (0 or
    MINUS) as the float values[at]. Returns 0."""
    if number >> 24:
        number >>= 1
        exponent += 1
    if exponent > 254:
        exponent = 255  # infinite
        number = 0
    elif exponent < 1:
        exponent = 0  # boards have no subnormal numbers
        number = 0
    values[at] = (exponent << 23) | (number & _FRACTION)
    ptr8(values)[4 * at + 3] |= sign
    return 0


@micropython.viper
def root(values: ptr32, at: int) -> int:
    """Replace values[at], a float that is not negative, by its square root, rounded to nearest.
    Returns 0.

    Digit by digit, as on paper: a bit of the result is 1 where the remainder is large enough for
    (2 * result + 1).
    """
    exponent = values[at] >> 23
    if exponent == 0:
        return 0
    # The radicand is from 1 to 4, with 24 bits after the point: the mantissa, or twice it if the
    # exponent without bias is odd. Each step uses its next two bits; after its end they are 0.
    radicand = ((values[at] & _FRACTION) | _LEADING) << (2 - (exponent & 1))
    result = 0
    remainder = 0
    for _ in range(25):  # bits of the root: one more than a mantissa, to round it
        remainder = (remainder << 2) | (radicand >> 24)
        radicand = (radicand & 0xFFFFFF) << 2
        if remainder > result << 1:
            remainder -= (result << 1) + 1
            result += 1
        result <<= 1  # once too often: undone below
    mantissa = ((result >> 1) + 1) >> 1
    return int(store(values, at, mantissa, ((exponent - 127) >> 1) + 127, 0))


@micropython.viper
def whole_part(values: ptr32, at: int, power: int) -> int:
    """Return values[at], a float, times 2**power, truncated; 0 if that has more than 30 bits."""
    # A mantissa, as a whole number of 24 bits, has the exponent 150: no shift.
    shift = ((values[at] >> 23) & 255) - 150 + power
    number = (values[at] & _FRACTION) | _LEADING
    if shift > 6 or shift < -24:  # more than 30 bits, or less than 1
        return 0
    number = number << shift if shift >= 0 else number >> (0 - shift)
    return 0 - number if ptr8(values)[4 * at + 3] & MINUS else number


@micropython.viper
def store_if_changed(stored: ptr32, at: int, values: ptr32, of: int) -> int:
    """Copy values[of] to stored[at]. Returns 1 if that has changed it, else 0."""
    if stored[at] == values[of]:
        return 0
    stored[at] = values[of]
    return 1


@micropython.viper
def add_single(a: ptr32, i: int, b: ptr32, j: int) -> int:
    """Set b[j] to a[i] + b[j], all floats as bits. Rounds to even. Returns 0."""
    sign_a = ptr8(a)[4 * i + 3] >> 7
    sign_b = ptr8(b)[4 * j + 3] >> 7
    # All bits but the sign, which compare as the floats do. Bit 30 comes from the last byte,
    # because a constant of 31 bits would be an object on the heap.
    x = (a[i] & _MAGNITUDE) | ((ptr8(a)[4 * i + 3] & 64) << 24)
    y = (b[j] & _MAGNITUDE) | ((ptr8(b)[4 * j + 3] & 64) << 24)
    if x < y:  # exchange them, so that x is the larger, and sign_a the sum's sign
        smaller = x
        x = y
        y = smaller
        smaller_sign = sign_a
        sign_a = sign_b
        sign_b = smaller_sign
    exponent = x >> 23
    shift = exponent - (y >> 23)
    if y >> 23 and shift < 27:  # else y is 0, or too small to change the sum
        # Three extra bits are enough for correct rounding; the last one is set where anything
        # below it is lost.
        y = ((y & _FRACTION) | _LEADING) << 3
        lost = y & ((1 << shift) - 1)
        y = (y >> shift) | (1 if lost else 0)
        x = ((x & _FRACTION) | _LEADING) << 3
        x = x + y if sign_a == sign_b else x - y
        if x == 0:
            exponent = 0
            sign_a = 0
        # Back to 24 bits and the three extra ones: the top bit is bit 26.
        while x and x < 1 << 26:
            x <<= 1
            exponent -= 1
        if x >= 1 << 27:
            x = (x >> 1) | (x & 1)
            exponent += 1
        eighths = x & 7  # the three extra bits
        x >>= 3
        if eighths > 4 or (eighths == 4 and x & 1):
            x += 1
        return int(store(b, j, x, exponent, sign_a << 7))
    b[j] = x  # the larger is the sum
    if sign_a:
        ptr8(b)[4 * j + 3] = ptr8(b)[4 * j + 3] | MINUS
    return 0


@micropython.viper
def add(numbers: ptr32, flip: int, sums: ptr32, count: int) -> int:
    """Add numbers[i] to sums[i], or subtract them, for i below count; all are floats as bits.

    flip: 0 adds. MINUS subtracts, and leaves the numbers negated. An infinite sum stays infinite.
    Returns 0.
    """
    for i in range(count):
        ptr8(numbers)[4 * i + 3] ^= flip
        if (sums[i] >> 23) & 255 != 255:
            add_single(numbers, i, sums, i)
    return 0
