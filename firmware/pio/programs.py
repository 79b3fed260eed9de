# mypy: ignore-errors
# ruff: noqa: F821
"""The programs of the PIO state machines: assembly only.

A machine advances one instruction per engine tick; a remark of a line says how many ticks
it takes. What the words mean is pulses.py's business, where they come from engine.py's.
"""

from rp2 import PIO, asm_pio

# One axis. A word, lowest bit first:
#
#     direction : 1 | steps : 12 | delay : 19
#
# asks for so many steps, each after a delay; a word without steps is the delay alone.
# ISR: length of a pulse, less 3 ticks; put there by the engine, never changed here.
#
# Counting from the tick in which a machine is ready for its next word (at `next`), the first
# edge comes after 6 + delay ticks, or the machine is ready again, if the word has no steps.
# From a step's edge it takes length + 9 + delay ticks to the next step of the same word,
# length + 3 to being ready for the next word.


@asm_pio(
    out_init=PIO.OUT_LOW,
    set_init=PIO.OUT_LOW,
    out_shiftdir=PIO.SHIFT_RIGHT,
    in_shiftdir=PIO.SHIFT_LEFT,
)
def stepper():
    label("next")
    pull(block)  #            1   stalls here where no word has come
    out(pins, 1)  #           1   DIR
    out(x, 12)  #             1   X: steps still to make
    label("step")
    mov(y, osr)  #            1   OSR: what is left of the word, the delay
    label("wait")
    jmp(y_dec, "wait")  #     1 + delay
    jmp(not_x, "next")  #     1   no steps wanted
    set(pins, 1)  #           1   STEP rises
    mov(y, isr)  #            1
    label("high")
    jmp(y_dec, "high")  #     1 + ISR
    set(pins, 0)  #           1   STEP falls
    jmp(x_dec, "made")  #     1   one less; goes to the next line either way
    label("made")
    jmp(not_x, "next")  #     1
    jmp("step")[2]  #        3   as long as fetching a word takes


# Where a stepper is, from its start: up to here X counts the step in progress …
NEXT = 0
STEP = 3
RISEN = 7  # … from here it is made, though X still counts it …
MADE = 11  # … and here X has been told.


# The clock. A word is the length of a segment, less 4 ticks; an interrupt at the end of each,
# and one when the machine is started.


@asm_pio()
def clock():
    label("next")
    irq(rel(0))  #            1   a segment is over, another begins
    pull(block)  #            1
    mov(x, osr)  #            1
    label("wait")
    jmp(x_dec, "wait")  #     1 + X


CLOCK_PULL = 1
