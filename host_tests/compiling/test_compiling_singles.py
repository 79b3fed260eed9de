"""What is done to f32() before the firmware is compiled."""

from ugrbl.compiling.singles import singles


def test_arithmetic_is_left_to_the_board() -> None:
    assert singles("x = f32(f32(a - b) * c)\n") == "x = ((a - b) * c)\n"
    assert singles("x = f32(math.sqrt(f32(a * a)))\n") == "x = (math.sqrt((a * a)))\n"
    assert singles("x = 2 * f32(0.1)\n") == "x = 2 * (0.1)\n"


def test_what_may_be_a_whole_number_becomes_a_float() -> None:
    for text in ("x = f32(a)\n", "x = f32(a.b)\n", "x = f32(count())\n", "x = f32(1)\n"):
        assert singles(text) == text


def test_no_line_moves() -> None:
    text = "x = f32(\n    ä + f32(a / b)\n)  # f32(a + b)\n"
    assert singles(text) == "x = (\n    ä + (a / b)\n)  # f32(a + b)\n"
