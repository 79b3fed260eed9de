# mypy: ignore-errors
# ruff: noqa: F821
"""The programs of the PIO state machines: assembly only.

A machine executes one instruction per engine tick (80 ns); the comment on a line says how many
ticks it takes. pulses.py makes the words, engine.py hands them over.

`stepper` makes the steps of one axis. A word, which out() reads from the lowest bit on:

    bit  31              13 12          1   0
        +------------------+-------------+---+
        |    delay : 19    |  steps : 12 |DIR|
        +------------------+-------------+---+

asks for so many steps in direction DIR, each after a delay in ticks; a word without steps is the
delay alone. ISR holds the length of a pulse less 3 ticks; the engine loads it (_load_isr()
in engine_state.py), and the program never changes it.

Times, from the tick in which a machine is ready for its next word (at `next`): the first edge
comes after 6 + delay ticks; without steps, the machine is ready again after 6 + delay ticks.
From a step's edge it is length + 9 + delay ticks to the next step of the same word, and length +
3 ticks until the machine is ready for the next word.
"""

from rp2 import PIO, asm_pio


@asm_pio(
    out_init=PIO.OUT_LOW,
    set_init=PIO.OUT_LOW,
    out_shiftdir=PIO.SHIFT_RIGHT,
    in_shiftdir=PIO.SHIFT_LEFT,
)
def stepper():
    label("next")
    pull(block)  #            1   stalls here if no word has come
    out(pins, 1)  #           1   DIR
    out(x, 12)  #             1   X: steps left
    label("step")
    mov(y, osr)  #            1   OSR: the rest of the word, the delay
    label("wait")
    jmp(y_dec, "wait")  #     1 + delay
    jmp(not_x, "next")  #     1   a word without steps
    set(pins, 1)  #           1   STEP rises
    mov(y, isr)  #            1
    label("high")
    jmp(y_dec, "high")  #     1 + ISR
    set(pins, 0)  #           1   STEP falls
    jmp(x_dec, "made")  #     1   one less; goes to the next line either way
    label("made")
    jmp(not_x, "next")  #     1
    jmp("step")[2]  #        3   as long as fetching a word takes


# Addresses in the stepper, from its start. Up to RISEN, X counts the step in progress.
NEXT = 0
STEP = 3
RISEN = 7  # from here the step is made, though X still counts it
MADE = 11  # and from here X does not count it any more


# The clock. A word is one number, the length of a segment less 4 ticks. The clock interrupts at
# the end of each segment, and when the machine starts.


@asm_pio()
def clock():
    label("next")
    irq(rel(0))  #            1   a segment ends, the next begins
    pull(block)  #            1
    mov(x, osr)  #            1
    label("wait")
    jmp(x_dec, "wait")  #     1 + X


CLOCK_PULL = 1
