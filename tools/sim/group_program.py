"""Run a program that uses ugrbl_motion in the simulator, in virtual time.

    python -m ugrbl.sim.group_program mount.py

It prints how long the program would take, and the steps and changes of outputs of each group.
Under MicroPython, sys.path has the firmware and tools/ already.
"""

import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .group_hardware import SimHardware


def run(text: str, name: str) -> "list[SimHardware]":
    """Run a program's text; return the hardware of its groups. name: of the program in
    tracebacks."""
    from .group_hardware import simulate
    from .virtual_asyncio import install

    made = simulate()
    install(made)
    exec(compile(text, name, "exec"), {"__name__": "__main__"})
    return made


def summary(hardware: "SimHardware") -> str:
    """Return a line: seconds, steps of each motor from the start, changes of outputs."""
    steps = " ".join(str(steps) for steps in hardware.steps())
    changes = len(hardware.outputs) - 1
    return f"{hardware.now_s:.3f} s; steps: {steps}; changes of outputs: {changes}"


def main() -> None:
    """Run the program that is named on the command line."""
    (name,) = sys.argv[1:]
    if sys.implementation.name == "cpython":
        from .. import paths

        paths.use_firmware()
    with open(name) as file:
        text = file.read()
    for hardware in run(text, name):
        print(summary(hardware))


if __name__ == "__main__":
    main()
