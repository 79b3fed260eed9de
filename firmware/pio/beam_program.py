# mypy: ignore-errors
# ruff: noqa: F821
"""The program of the machine that changes a beam's power: assembly only.

It plays the words of programs.stepper in the same times, to the tick. In place of a step it hands
a word to DMA, which then moves the next level; what the word says nobody reads.
"""

from rp2 import PIO, asm_pio


@asm_pio(out_shiftdir=PIO.SHIFT_RIGHT, in_shiftdir=PIO.SHIFT_LEFT)
def beam():
    label("next")
    pull(block)  #            1
    out(null, 1)  #           1   no direction
    out(x, 12)  #             1   X: changes still to make
    label("step")
    mov(y, osr)  #            1   the delay
    label("wait")
    jmp(y_dec, "wait")  #     1 + delay
    jmp(not_x, "next")  #     1
    mov(y, isr)  #            1   a push clears ISR, which is the length of a pulse less 3
    push(block)  #            1   the change: a tick behind where a step would be
    mov(isr, y)  #            1
    label("high")
    jmp(y_dec, "high")  #     1 + ISR
    jmp(x_dec, "made")  #     1
    label("made")
    jmp(not_x, "next")  #     1
    jmp("step")[2]  #        3
