# mypy: ignore-errors
# ruff: noqa: F821
"""The program of the machine that changes a beam's power: assembly only.

It reads the words of programs.stepper, in the same times, to the tick:

    bit  31              13 12          1   0
        +------------------+-------------+---+
        |    delay : 19    | changes : 12| - |
        +------------------+-------------+---+

Instead of a step it pushes a word, which makes DMA move the next level. Nothing reads the pushed
word. The comments say how many ticks a line takes.
"""

from rp2 import PIO, asm_pio


@asm_pio(out_shiftdir=PIO.SHIFT_RIGHT, in_shiftdir=PIO.SHIFT_LEFT)
def beam():
    label("next")
    pull(block)  #            1
    out(null, 1)  #           1   bit 0: no direction
    out(x, 12)  #             1   X: changes left
    label("step")
    mov(y, osr)  #            1   OSR: the rest of the word, the delay
    label("wait")
    jmp(y_dec, "wait")  #     1 + delay
    jmp(not_x, "next")  #     1   a word without changes
    mov(y, isr)  #            1   a push clears ISR, which holds the length of a pulse less 3
    push(block)  #            1   the change: one tick after a stepper's edge
    mov(isr, y)  #            1
    label("high")
    jmp(y_dec, "high")  #     1 + ISR
    jmp(x_dec, "made")  #     1   one less; goes to the next line either way
    label("made")
    jmp(not_x, "next")  #     1
    jmp("step")[2]  #        3   as long as fetching a word takes
