"""Stops and holds of all kinds at random instants on the emulated Pico.

The machine is streaming, and at some instant a limit switch closes, the reset or the hold button
is pressed, a Ctrl-X or a `!` arrives. Behind a stop there is no edge on a step pin nor on the
spindle's later than docs/faults.md says, and the reset that follows ends in a machine that works
and knows where it is, counted from the edges. A hold loses no step.

A trial costs 2 CPU seconds, for it is a future of a machine that streams on. A thousand of
them is `make torture-board`; what has failed is played again, alone, by the seed it names:

    UGRBL_INJECTION=137 .venv/bin/pytest -q host_tests/emulator/test_pico_injection.py

Where processes cannot be forked (Windows), one trial comes behind the other, each with a life of
its own: the same laws, several times slower.
"""

import os
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

import pytest
from emulated import DIR, SPINDLE_PWM, STEP, Board, Odometer, altered
from futures import HAVE_FORK, futures, told
from injection import ACTS, SETTINGS, SILENCE, TRIALS_PER_LIFE, Life, Outcome, Trial

pytestmark = pytest.mark.xdist_group("pico injection")

_ALONE = os.environ.get("UGRBL_INJECTION", "")
_SEEDS = [int(_ALONE)] if _ALONE else range(int(os.environ.get("UGRBL_INJECTIONS", "45")))
_LIVES = sorted({seed // TRIALS_PER_LIFE for seed in _SEEDS})


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Board:
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
    """All of them; pytest -s shows how many of each kind there were, and the slowest."""
    found: list[Outcome] = []
    yield found
    for act in ACTS:
        alike = [outcome for outcome in found if outcome.act == act]
        if alike:
            last = max(alike, key=lambda outcome: outcome.latency_us)
            longest = f"{last.latency_us:.0f} us to the last edge, seed {last.seed}"
            print(f"\n{act}: {len(alike)}; at most {longest}", end="")


def _trials(life: int) -> "list[Trial]":
    """In the order in which they come."""
    first = life * TRIALS_PER_LIFE
    trials = map(Trial, range(first, first + TRIALS_PER_LIFE))
    return sorted(trials, key=lambda trial: trial.at_us)


def _play_forked(
    life: Life, trials: "list[Trial]", seeds: "Collection[int]", tell: "Callable[[Outcome], None]"
) -> None:
    """Stream past all instants, and play each trial that is wanted in a process of its own."""
    life.start()
    with futures() as play:
        for trial in trials:
            life.run_to(trial.at_us)
            if trial.seed in seeds:
                play(lambda trial=trial: tell(trial.outcome(life)))


def _play_in_turn(life: Life, trial: Trial) -> Outcome:
    """The same of one trial, here."""
    life.start()
    life.run_to(trial.at_us)
    outcome = trial.outcome(life)
    if outcome.trouble:
        trial.make_usable(life.machine)
    return outcome


def _outcomes(
    make_life: "Callable[[], Life]", trials: "list[Trial]", seeds: "Collection[int]"
) -> "list[Outcome]":
    """Of the trials with these seeds; none is missing."""
    if not HAVE_FORK:
        return [_play_in_turn(make_life(), trial) for trial in trials if trial.seed in seeds]
    found, ended = told(lambda tell: _play_forked(make_life(), trials, seeds, tell))
    outcomes = [Outcome(*each) for each in found]
    missing = set(seeds) - {outcome.seed for outcome in outcomes}
    assert ended and not missing, f"nothing was heard of the trials {sorted(missing)}"
    return outcomes


@pytest.mark.parametrize("number", _LIVES)
def test_at_any_instant(
    machine: Board, odometer: Odometer, played: "list[Outcome]", number: int
) -> None:
    trials = _trials(number)
    seeds = {trial.seed for trial in trials}.intersection(_SEEDS)
    outcomes = _outcomes(lambda: Life(machine, odometer, number), trials, seeds)
    played += outcomes
    troubles = [outcome.trouble for outcome in outcomes if outcome.trouble]
    assert not troubles, "\n".join(troubles)


def test_a_stop_that_does_not_come_is_found(
    machine: Board, odometer: Odometer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What this file is worth."""
    monkeypatch.setattr(Trial, "_inject", lambda trial: None)
    trial = Trial(2)
    (outcome,) = _outcomes(lambda: Life(machine, odometer, 1), [trial], {trial.seed})
    assert "Ctrl-X" in outcome.trouble and "it moved on" in outcome.trouble
