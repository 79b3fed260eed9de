"""Test the settings: the table is the only source, and stored values come back.

settings_at_start() are settings as loaded from a store; values_of() are their values by $-number.
"""

import ast
import inspect
from typing import Any

import pytest
from base import errors
from base import settings as module
from base.errors import GrblError
from base.settings import _TABLE, ALL, AXIS, Settings
from hypothesis import given
from hypothesis import strategies as st
from rig_bench import Machine
from ugrbl.sim.rig import MemoryStore

SOURCE = inspect.getsource(module)


def settings_at_start(store: "MemoryStore | None" = None, **board) -> Settings:
    """Return settings as they are at a start. board: defaults, max_step_hz, step_pulse_min_us."""
    settings = Settings(store or MemoryStore(), axes=3, defaults=board.get("defaults", {}))
    settings.max_step_hz = board.get("max_step_hz", 0)
    settings.step_pulse_min_us = board.get("step_pulse_min_us", settings.step_pulse_min_us)
    settings.load()
    return settings


def values_of(settings: Settings) -> "dict[int, float]":
    return {number: value for number, value, _ in settings.each()}


NUMBERS = sorted(values_of(settings_at_start()))

# The table


def table_rows() -> "list[ast.expr]":
    """Return the syntax trees of the rows of _TABLE."""
    for node in ast.walk(ast.parse(SOURCE)):
        if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == "_TABLE":
            assert isinstance(node.value, ast.Tuple)
            return node.value.elts
    raise AssertionError("there is no _TABLE")


@pytest.mark.parametrize("row", table_rows(), ids=lambda row: f"${row.elts[0].value}")
def test_every_setting_is_documented_above_its_row(row: ast.expr) -> None:
    above = SOURCE.splitlines()[row.lineno - 2].strip()
    assert above.startswith("# "), "the comment above a row is its documentation"


def test_rows_and_annotations_agree() -> None:
    """Each row has an attribute of Settings; one value per axis is an array."""
    kinds = {name: str(kind) for name, kind in Settings.__annotations__.items()}
    assert list(kinds) == [name for _, name, *_ in _TABLE]
    for _, name, kind, *_ in _TABLE:
        assert ("array" in kinds[name]) == (kind == AXIS)


def test_numbers_rise_and_are_used_once() -> None:
    numbers = [number for number, *_ in _TABLE]
    assert numbers == sorted(set(numbers))
    assert NUMBERS == [number for number, *_ in settings_at_start().each()]


def test_defaults_are_allowed_values() -> None:
    settings = settings_at_start()
    for number, value in values_of(settings).items():
        settings.set(number, value)


def test_board_may_have_its_own_defaults() -> None:
    assert values_of(settings_at_start(defaults={101: 80.0}))[101] == 80


# Storing

amounts = st.integers(0, 2_000_000).map(lambda n: n / 1000)
changes = st.lists(st.tuples(st.sampled_from(NUMBERS), amounts), max_size=12)


@given(changes)
def test_stored_value_comes_back(changes: "list[tuple[int, float]]") -> None:
    """A refused change has no effect; a new object with the same store has the same values."""
    store = MemoryStore()
    settings = settings_at_start(store)
    for number, amount in changes:
        before = values_of(settings)
        try:
            settings.set(number, amount)
        except GrblError:
            assert values_of(settings) == before
    again = Settings(store, axes=3, defaults={})
    assert again.load()
    assert values_of(again) == values_of(settings)


def test_fine_resolution_is_loaded_with_the_slow_rate_it_needs() -> None:
    """$100 = 5000 steps/mm is allowed only with a low $110, which is stored after it: 60 mm/min
    are 5000 steps/s."""
    store = MemoryStore()
    settings = settings_at_start(store, max_step_hz=30_000)
    settings.set(110, 60)
    settings.set(100, 5000)
    assert values_of(settings_at_start(store, max_step_hz=30_000))[100] == 5000


@pytest.mark.parametrize("least", [1, 2, 3])
def test_pulses_are_at_least_as_long_as_the_board_says(least: int) -> None:
    """least: STEP_PULSE_MIN_US of the board; $0 is the length of pulses in us."""
    settings = settings_at_start(step_pulse_min_us=least)
    settings.set(0, least)
    with pytest.raises(GrblError) as refused:
        settings.set(0, least - 1)
    assert (refused.value.code, settings.step_pulse_us) == (errors.SETTING_STEP_PULSE_MIN, least)


def test_a_board_without_the_option_has_pulses_of_3_us_even_if_shorter_ones_are_stored() -> None:
    store = MemoryStore()
    settings_at_start(store, step_pulse_min_us=1).set(0, 1)
    assert settings_at_start(store, step_pulse_min_us=1).step_pulse_us == 1
    assert settings_at_start(store).step_pulse_us == 3


def test_soft_limits_are_loaded_with_the_homing_they_need() -> None:
    """$20 needs $22, which is loaded after it."""
    store = MemoryStore()
    settings = settings_at_start(store)
    settings.set(22, 1)
    settings.set(20, 1)
    assert settings_at_start(store).soft_limits == 1


def test_lines_of_another_firmware_are_kept() -> None:
    store = MemoryStore()
    settings_at_start(store)
    store.files["settings"].append("$341=2")  # a setting unknown here
    settings = settings_at_start(store)
    settings.set(110, 700)
    assert "$341=2" in store.files["settings"]
    assert values_of(settings_at_start(store))[110] == 700


def test_restore_removes_changed_values() -> None:
    settings = settings_at_start()
    settings.set(110, 700)
    settings.restore()
    assert values_of(settings) == values_of(settings_at_start())


# Notification


def collect_changes(settings: Settings) -> "list[int]":
    """Return the list in which the numbers of later changes are collected."""
    numbers: list[int] = []
    settings.on_change(lambda: numbers.append(settings.changed))
    return numbers


def test_every_subscriber_is_notified_of_every_change() -> None:
    """ALL: many settings at once, by restore() and load()."""
    settings = settings_at_start()
    first, second = collect_changes(settings), collect_changes(settings)
    settings.set(110, 700)
    settings.set(112, 700)
    settings.restore()
    settings.load()
    assert first == second == [110, 112, ALL, ALL]


def test_subscriber_is_notified_after_the_change_and_before_it_is_stored() -> None:
    """It sees the new value, and the old lines in the store."""
    store = MemoryStore()
    settings = settings_at_start(store)
    notified: list[object] = []
    settings.on_change(
        lambda: notified.append((settings.max_rate[0], list(store.files["settings"])))
    )
    before = list(store.files["settings"])
    settings.set(110, 700)
    assert notified == [(700, before)]
    assert store.files["settings"] != before


@pytest.mark.parametrize(("number", "amount"), [(0, 2), (20, 1), (40, 1), (110, -1)])
def test_refused_change_is_not_notified(number: int, amount: float) -> None:
    """Too short a pulse, soft limits without homing, an unknown number, a negative rate."""
    settings = settings_at_start()
    numbers = collect_changes(settings)
    with pytest.raises(GrblError):
        settings.set(number, amount)
    assert numbers == []


@pytest.mark.parametrize("stored", [None, ["$110=5x0"]])
def test_defaults_after_unreadable_settings_are_notified_once(stored: object) -> None:
    """stored: the lines in the store; None: there are none."""
    store: Any = MemoryStore()
    if stored:
        store.files["settings"] = stored
    settings = Settings(store, axes=3, defaults={})
    numbers = collect_changes(settings)
    assert not settings.load()
    assert numbers == [ALL]


# Damage


def output_at_start(machine: Machine) -> "list[str]":
    """Switch the machine on and return its output."""
    machine.run(machine.start())
    return machine.received


@pytest.mark.parametrize(
    "damage",
    [
        None,
        ["$0=10", "$1"],
        ["$110=5x0.000"],
        ["$110=-5"],
        ["$110=nan"],
        ["$0=inf"],
        ["$0=1e400"],
        ["$=1"],
        [""],
        ["\0\0\0\0"],
    ],
)
def test_damaged_settings_are_restored_and_reported(damage: "list[str] | None") -> None:
    """damage: the stored lines; None: there are none. error:7 is Grbl's report of it; settings
    follow."""
    machine = Machine(watched=False)
    files = machine.rig.store.files
    if damage is None:
        del files["settings"]
    else:
        files["settings"] = damage
    received = output_at_start(machine)
    assert received[0] == "error:7"
    assert "$110=500.000" in received
    assert any(line.startswith("Grbl 1.1h") for line in received)
    machine = Machine(watched=False)
    machine.rig.store.files.update(files)
    assert output_at_start(machine)[:2] == ["", "Grbl 1.1h ['$' for help]"], "reported once"


@given(st.lists(st.text("$=0123456789.eE-+ inf\x00\xff", max_size=20), max_size=8))
def test_machine_starts_after_any_damage_to_stored_settings(lines: "list[str]") -> None:
    machine = Machine(watched=False)
    machine.rig.store.files["settings"] = lines
    assert any(line.startswith("Grbl 1.1h") for line in output_at_start(machine))


class NewStore(MemoryStore):
    """A store in which nothing was ever stored: no copy exists, so none is damaged."""

    def load(self, name: str) -> "list[str] | None":
        return self.files.get(name, [])


def test_new_board_stores_factory_settings_and_reports_them_once_after_the_welcome() -> None:
    machine = Machine(watched=False)
    machine.rig.store = store = NewStore()
    message = "[MSG:First start: factory settings]"
    assert output_at_start(machine) == ["", "Grbl 1.1h ['$' for help]", message]
    assert "$110=500" in store.files["settings"], "they are written"
    machine = Machine(watched=False)
    machine.rig.store = store
    assert output_at_start(machine) == ["", "Grbl 1.1h ['$' for help]"]


def test_reset_does_not_repeat_the_first_start_message() -> None:
    machine = Machine(watched=False)
    machine.rig.store = NewStore()
    machine.play(["$I", "\x18"])
    assert sum("First start" in line for line in machine.received) == 1


def test_intact_settings_are_not_reported() -> None:
    assert output_at_start(Machine({110: 700})) == ["", "Grbl 1.1h ['$' for help]"]


class FullStore(MemoryStore):
    """A store that refuses every write."""

    def save(self, name: str, lines: object) -> None:
        raise OSError(28)  # ENOSPC


def test_machine_with_full_flash_starts_with_defaults_and_reports_it() -> None:
    machine = Machine(watched=False)
    machine.rig.store = FullStore()
    machine.play(["G91", "G1X1F300", "$110=600"])
    # three stores at the start, and $110
    assert machine.received.count("[MSG:Flash is full or worn: not saved]") == 4
    assert "$110=500.000" in machine.received
    assert machine.received[-2:-1] == ["error:7"]  # the answer to $110, before the last report
    assert machine.physical() == [250, 0, 0]  # it moved 1 mm
