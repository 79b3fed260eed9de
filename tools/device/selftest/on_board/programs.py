# mypy: ignore-errors
# ruff: noqa: F821
"""Programs of the watching machines of PIO 1: assembly only. They read pins and drive none."""

from rp2 import PIO, asm_pio


@asm_pio()
def count_program():
    """Count steps of one axis. in_base: STEP; jmp_pin: DIR, which gives the direction when STEP
    rises. X counts down for each step forward, Y for each backward, both from 2**32 - 1."""
    wrap_target()
    label("next")
    wait(0, pin, 0)
    wait(1, pin, 0)  # STEP rises
    jmp(pin, "back")  # if DIR is high
    jmp(x_dec, "next")  # X -= 1
    jmp("next")  # if X was 0
    label("back")
    jmp(y_dec, "next")
    wrap()


# All pins, in each tick.


@asm_pio(autopush=True, push_thresh=32, fifo_join=PIO.JOIN_RX)
def sample_program():
    wrap_target()
    in_(pins, 32)
    wrap()
