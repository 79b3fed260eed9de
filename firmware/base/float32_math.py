# mypy: disable-error-code=arg-type
"""Single precision by integers only: positions as Grbl computes them, in viper kernels.

A float of MicroPython is a piece of memory, and takes longer to make than all that is done here.
"""

import micropython
from micropython import const

MINUS = const(128)  # in the last byte of a float


@micropython.viper
def mantissas(number: int, divisor: int) -> int:
    """The mantissa of a quotient from 1 to 2, rounded to even. divisor: 24 bits."""
    rest = number - divisor
    number = 1
    for _ in range(4):
        rest <<= 7
        digit = rest // divisor
        number = (number << 7) + digit
        rest -= digit * divisor
    # Five bits more than there is room for; what is left matters only behind a half.
    if rest:
        number |= 1
    return (number + 15 + ((number >> 5) & 1)) >> 5


@micropython.viper
def divide(numbers: ptr32, divisors: ptr32, at: int, quotients: ptr32, count: int) -> int:
    """Divide whole numbers, made floats first, by the floats above 0 at divisors[at].

    Floats are seen as bits, and rounded to the nearest, halves to even. Numbers have 30 bits.
    """
    for i in range(count):
        number = numbers[i]
        minus = ptr8(numbers)[4 * i + 3] & MINUS
        if minus:
            number = 0 - number
        number &= 0x3FFFFFFF
        quotients[i] = 0
        if number:
            exponent = 0
            while number >> exponent >= 1 << 24:
                exponent += 1
            if exponent:
                number += (1 << (exponent - 1)) - 1 + ((number >> exponent) & 1)
                number >>= exponent
            divisor = divisors[at + i]
            exponent += 277 - (divisor >> 23)
            divisor = (divisor & 0x7FFFFF) | 0x800000
            while number < divisor:
                number <<= 1
                exponent -= 1
            store(quotients, i, int(mantissas(number, divisor)), exponent, minus)
    return 0


@micropython.viper
def multiply(values: ptr32, at: int, factors: ptr32, of: int) -> int:
    """Make values[at] its product with factors[of], all bits of single-precision floats, rounded
    to even."""
    exponent = (values[at] >> 23) & 255
    if exponent == 0:
        return 0
    power = (factors[of] >> 23) & 255
    if power == 0:
        exponent = 0
    exponent += power - 126
    sign = (ptr8(values)[4 * at + 3] ^ ptr8(factors)[4 * of + 3]) & MINUS
    factor = (factors[of] & 0x7FFFFF) | 0x800000
    number = (values[at] & 0x7FFFFF) | 0x800000
    middle = (number >> 12) * (factor & 0xFFF) + (number & 0xFFF) * (factor >> 12)
    low = (number & 0xFFF) * (factor & 0xFFF) + ((middle & 0xFFF) << 12)
    number = (number >> 12) * (factor >> 12) + (middle >> 12) + (low >> 24)
    low &= 0xFFFFFF
    if number < 1 << 23:
        number = (number << 1) | (low >> 23)
        low = (low << 1) & 0xFFFFFF
        exponent -= 1
    if low > 0x800000 or (low == 0x800000 and number & 1):
        number += 1
    return int(store(values, at, number, exponent, sign))


@micropython.viper
def quotient(values: ptr32, at: int, divisors: ptr32, of: int) -> int:
    """Make values[at] its quotient by divisors[of], which is not 0; as multiply() does."""
    exponent = (values[at] >> 23) & 255
    if exponent == 0:
        return 0
    sign = (ptr8(values)[4 * at + 3] ^ ptr8(divisors)[4 * of + 3]) & MINUS
    exponent += 127 - ((divisors[of] >> 23) & 255)
    number = (values[at] & 0x7FFFFF) | 0x800000
    divisor = (divisors[of] & 0x7FFFFF) | 0x800000
    if number < divisor:
        number <<= 1
        exponent -= 1
    return int(store(values, at, int(mantissas(number, divisor)), exponent, sign))


@micropython.viper
def store(values: ptr32, at: int, number: int, exponent: int, sign: int) -> int:
    """Put a number of 24 bits, or one more than they hold, into values[at] as a float."""
    if number >> 24:
        number >>= 1
        exponent += 1
    if exponent > 254:
        exponent = 255  # infinite
        number = 0
    elif exponent < 1:
        exponent = 0  # too small for a board
        number = 0
    values[at] = (exponent << 23) | (number & 0x7FFFFF)
    ptr8(values)[4 * at + 3] |= sign
    return 0


@micropython.viper
def root(values: ptr32, at: int) -> int:
    """Make values[at], a float that is not negative, its square root, rounded to the nearest."""
    exponent = values[at] >> 23
    if exponent == 0:
        return 0
    # With an even exponent, two bits above the mantissa's and 24 of them, all 0, behind it: a root
    # of 25 bits. Two bits are looked at for each of its own.
    number = ((values[at] & 0x7FFFFF) | 0x800000) << (2 - (exponent & 1))
    found = 0
    rest = 0
    for _ in range(25):
        rest = (rest << 2) | (number >> 24)
        number = (number & 0xFFFFFF) << 2
        if rest > found << 1:
            rest -= (found << 1) + 1
            found += 1
        found <<= 1
    return int(store(values, at, ((found >> 1) + 1) >> 1, ((exponent - 127) >> 1) + 127, 0))


@micropython.viper
def whole_part(values: ptr32, at: int, power: int) -> int:
    """The whole part of values[at], a float, times 2**power; 0 where that has over 30 bits."""
    shift = ((values[at] >> 23) & 255) - 150 + power
    number = (values[at] & 0x7FFFFF) | 0x800000
    if shift > 6 or shift < -24:
        return 0
    number = number << shift if shift >= 0 else number >> (0 - shift)
    return 0 - number if ptr8(values)[4 * at + 3] & MINUS else number


@micropython.viper
def store_if_changed(kept: ptr32, at: int, values: ptr32, of: int) -> int:
    """Make kept[at] values[of]. Returns whether it was another."""
    if kept[at] == values[of]:
        return 0
    kept[at] = values[of]
    return 1


@micropython.viper
def add_single(a: ptr32, i: int, b: ptr32, j: int) -> int:
    """Make b[j] the sum of a[i] and b[j], all bits of single-precision floats, rounded to even."""
    sign_a = ptr8(a)[4 * i + 3] >> 7
    sign_b = ptr8(b)[4 * j + 3] >> 7
    x = (a[i] & 0x3FFFFFFF) | ((ptr8(a)[4 * i + 3] & 64) << 24)
    y = (b[j] & 0x3FFFFFFF) | ((ptr8(b)[4 * j + 3] & 64) << 24)
    if x < y:
        shift = x
        x = y
        y = shift
        shift = sign_a
        sign_a = sign_b
        sign_b = shift
    exponent = x >> 23
    shift = exponent - (y >> 23)
    if y >> 23 and shift < 27:
        # Three more bits, the last one sticky, are enough to round as if all were there.
        y = ((y & 0x7FFFFF) | 0x800000) << 3
        rest = y & ((1 << shift) - 1)
        y = (y >> shift) | (1 if rest else 0)
        x = ((x & 0x7FFFFF) | 0x800000) << 3
        x = x + y if sign_a == sign_b else x - y
        if x == 0:
            exponent = 0
            sign_a = 0
        while x and x < 1 << 26:
            x <<= 1
            exponent -= 1
        if x >= 1 << 27:
            x = (x >> 1) | (x & 1)
            exponent += 1
        rest = x & 7
        x >>= 3
        if rest > 4 or (rest == 4 and x & 1):
            x += 1
        return int(store(b, j, x, exponent, sign_a << 7))
    b[j] = x
    if sign_a:
        ptr8(b)[4 * j + 3] = ptr8(b)[4 * j + 3] | 128
    return 0


@micropython.viper
def add(numbers: ptr32, flip: int, sums: ptr32, count: int) -> int:
    """Add floats, or take them away: flip is 0 or MINUS. numbers are negative afterwards, then.

    What is infinite stays so.
    """
    for i in range(count):
        ptr8(numbers)[4 * i + 3] ^= flip
        if (sums[i] >> 23) & 255 != 255:
            add_single(numbers, i, sums, i)
    return 0
