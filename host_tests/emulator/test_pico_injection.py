"""Test stops and holds of all kinds at random instants on the emulated Pico.

In a life the machine streams a program. In a trial, at some instant of a life, a limit switch
closes, the reset or the hold button is pressed, or a Ctrl-X or a `!` arrives. After a stop the
last edge on a step pin or the spindle's pin comes within the time in docs/faults.md. The reset
that follows ends in a machine that works and whose position is right, counted from the edges. A
hold loses no step.

A trial costs 2 CPU seconds, because it is a future of a machine that keeps streaming. A thousand
of them is `make torture-board`. A failed trial is repeated alone by the seed that it names:

    UGRBL_INJECTION=137 .venv/bin/pytest -q host_tests/emulator/test_pico_injection.py

Where processes cannot be forked (Windows), one trial runs after the other, each with a life of
its own: the same laws, several times slower.
"""

import os
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

import pytest
from emulated import DIR, SPINDLE_PWM, STEP, Board, Odometer, altered
from futures import HAVE_FORK, futures, results_of
from injection import ACTS, SETTINGS, SILENCE, TRIALS_PER_LIFE, Life, Outcome, Trial

pytestmark = pytest.mark.xdist_group("pico injection")

_ALONE = os.environ.get("UGRBL_INJECTION", "")
_SEEDS = [int(_ALONE)] if _ALONE else range(int(os.environ.get("UGRBL_INJECTIONS", "45")))
_LIVES = sorted({seed // TRIALS_PER_LIFE for seed in _SEEDS})


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Board:
    """Return a board that is set up.

    SILENCE shortens the silence of the firmware after an alarm: a trial takes less time.
    """
    made = Board(uf2, altered(*SILENCE)).boot().settled()
    for setting in SETTINGS:
        assert made.ask(setting) == "ok\r\n"
    made.pico.record([*STEP, *DIR, SPINDLE_PWM])
    return made


@pytest.fixture(scope="module")
def odometer(machine: Board) -> Odometer:
    return Odometer(machine.pico)


@pytest.fixture(scope="module")
def played() -> "Iterator[list[Outcome]]":
    """Collect all outcomes; pytest -s shows the number of each kind, and the slowest."""
    outcomes: list[Outcome] = []
    yield outcomes
    for act in ACTS:
        of_this_kind = [outcome for outcome in outcomes if outcome.act == act]
        if of_this_kind:
            slowest = max(of_this_kind, key=lambda outcome: outcome.latency_us)
            longest = f"{slowest.latency_us:.0f} us to the last edge, seed {slowest.seed}"
            print(f"\n{act}: {len(of_this_kind)}; at most {longest}", end="")


def _trials(life: int) -> "list[Trial]":
    """Return the trials of a life, which is one run of a streaming machine, ordered by time."""
    first = life * TRIALS_PER_LIFE
    trials = map(Trial, range(first, first + TRIALS_PER_LIFE))
    return sorted(trials, key=lambda trial: trial.at_us)


def _play_forked(
    life: Life, trials: "list[Trial]", seeds: "Collection[int]", send: "Callable[[Outcome], None]"
) -> None:
    """Stream past the instants of all trials, and run each trial with one of the seeds in a forked
    process. send() passes its outcome to the parent."""
    life.start()
    with futures() as play:
        for trial in trials:
            life.run_to(trial.at_us)
            if trial.seed in seeds:
                play(lambda trial=trial: send(trial.outcome(life)))


def _play_alone(life: Life, trial: Trial) -> Outcome:
    """Run one trial in this process."""
    life.start()
    life.run_to(trial.at_us)
    outcome = trial.outcome(life)
    if outcome.trouble:  # the trial has ended early; the next one needs an idle machine
        trial.make_usable(life.machine)
    return outcome


def _outcomes(
    make_life: "Callable[[], Life]", trials: "list[Trial]", seeds: "Collection[int]"
) -> "list[Outcome]":
    """Return the outcomes of the trials with these seeds; raise if one is missing.

    make_life() returns a machine that can be streamed to.
    """
    if not HAVE_FORK:
        return [_play_alone(make_life(), trial) for trial in trials if trial.seed in seeds]
    # results_of() returns all that was passed to send(), and whether the processes ended well.
    fields, ended = results_of(lambda send: _play_forked(make_life(), trials, seeds, send))
    outcomes = [Outcome(*each) for each in fields]
    missing = set(seeds) - {outcome.seed for outcome in outcomes}
    assert ended and not missing, f"no result of the trials {sorted(missing)}"
    return outcomes


@pytest.mark.parametrize("number", _LIVES)
def test_stop_or_hold_at_any_instant_keeps_all_laws(
    machine: Board, odometer: Odometer, played: "list[Outcome]", number: int
) -> None:
    """number: of the life. The laws are in the module's docstring; trouble: the broken one."""
    trials = _trials(number)
    seeds = {trial.seed for trial in trials}.intersection(_SEEDS)
    outcomes = _outcomes(lambda: Life(machine, odometer, number), trials, seeds)
    played += outcomes
    troubles = [outcome.trouble for outcome in outcomes if outcome.trouble]
    assert not troubles, "\n".join(troubles)


def test_missing_stop_is_found(
    machine: Board, odometer: Odometer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This shows that the other test of the file can fail: nothing is injected."""
    monkeypatch.setattr(Trial, "_inject", lambda trial: None)
    trial = Trial(2)  # the seed of a trial with Ctrl-X
    (outcome,) = _outcomes(lambda: Life(machine, odometer, 1), [trial], {trial.seed})
    assert "Ctrl-X" in outcome.trouble and "it moved on" in outcome.trouble
