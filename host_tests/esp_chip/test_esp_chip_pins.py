"""Test the pins of the ESP32 on stand-ins.

Limits of X, Y and Z are at pins 13, 5 and 36, the probe at 39, control inputs at 4 and 35; all are
closed at level 0. clock.advance() lets time pass until then, clock.work() for so long without
callbacks, both in us. with_lost_edge() makes a change of a pin while callbacks are lost.
"""

from collections.abc import Iterator
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from esp_bench import clock, esp_machine, gpio_esp, reset_stand_ins

Pin = esp_machine.Pin

BOARD: dict[str, Any] = {
    "ENABLE": 12,
    "LIMIT": (13, 5, 36),
    "PROBE": 39,
    "CONTROL": (None, 4, 35, None),
    "SPINDLE_PWM": 23,
    "SPINDLE_DIR": 18,
    "FLOOD": 22,
    "NO_PULL_UP": (35, 36, 39),
}


@pytest.fixture(autouse=True)
def new_chip(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    reset_stand_ins()
    monkeypatch.setattr(esp_machine.WDT, "fed", 0)
    yield
    reset_stand_ins()


def make_port(enable: Any = None, **changes: Any) -> "tuple[Any, list[str]]":
    """Return the port of BOARD with these changes, and the list of its calls to the listener.

    enable: switches the motors' power, if an output of the engine does.
    """
    board = ModuleType("board")
    vars(board).update({**BOARD, **changes})
    for pin in board.NO_PULL_UP:  # a resistor on the board pulls it up
        Pin(pin, Pin.IN).drive(1)
    port = gpio_esp.EspPort(board, enable)
    calls: list[str] = []
    names = ("limits", "controls", "fault")
    notes = {f"on_{name}": lambda *_, n=name: calls.append(n) for name in names}
    port.attach(SimpleNamespace(**notes))
    port.enable_limits(True)
    return port, calls


def test_inputs_pulled_to_ground_are_closed_and_reported() -> None:
    port, calls = make_port()
    assert (port.limits(), port.controls(), port.probe()) == (0, 0, False)
    for pin in (5, 35, 39):  # limit of Y, third control input, probe
        Pin(pin).drive(0)
    assert (port.limits(), port.controls(), port.probe()) == (2, 4, True)
    assert calls == ["limits", "controls"]


def test_bouncing_button_is_reported_once() -> None:
    _, calls = make_port(CONTROL_DEBOUNCE_MS=20)
    for level in (0, 1, 0, 1, 0):
        Pin(4).drive(level)  # a control input
    clock.advance(clock.us + 100_000)  # more than the time of debouncing
    assert calls == ["controls"]
    Pin(4).drive(1)
    assert calls == ["controls", "controls"]


def test_probe_is_reported_once() -> None:
    port, _ = make_port()
    contacts: list[bool] = []
    port.watch_probe(lambda: contacts.append(True), closed=True)
    for level in (0, 1, 0):
        Pin(39).drive(level)  # the probe
    assert contacts == [True]


def test_motors_are_off_until_the_machine_enables_them() -> None:
    port, _ = make_port()
    assert Pin(12).level == 1
    port.enable(0)
    assert Pin(12).level == 0


def test_enable_may_be_an_output_of_the_engine() -> None:
    levels: list[int] = []
    port, _ = make_port(levels.append, ENABLE=0)
    port.enable(1)
    assert levels == [1] and 0 not in Pin.pins


def test_safe_switches_all_tool_outputs_off() -> None:
    """Spindle on (pin 19) and its PWM (23), mist (21) and flood (22)."""
    port, _ = make_port(MIST_PIN=21, SPINDLE_ON=19)
    port.spindle(True, 1000)
    port.coolant(3)  # flood and mist
    assert [Pin(pin).level for pin in (19, 21, 22)] == [1, 1, 1]
    assert Pin(23).log[-1][1] == 65535  # the last duty of the PWM
    port.safe()
    assert [Pin(pin).level for pin in (19, 21, 22)] == [0, 0, 0]
    assert Pin(23).log[-1][1] == 0


def test_extra_has_pins() -> None:
    """Outputs 32 and 33 and inputs 25 and 26, which drive() and sense() address by masks."""
    port, _ = make_port()
    port.add_pins((32, 33), (25, 26))
    changes: list[bool] = []
    port.watch_pins(lambda: changes.append(True))
    port.drive(1)
    assert (Pin(32).level, Pin(33).level, port.sense()) == (1, 0, 3)
    Pin(26).drive(0)
    assert (port.sense(), len(changes)) == (1, 1)


def test_button_asks_for_the_prompt() -> None:
    """held(): whether the button at the board's REPL_PIN, if it has one, is pressed."""
    port, _ = make_port()
    assert not port.held(None)
    assert not port.held(14)
    Pin(14).drive(0)
    assert port.held(14)


def test_watchdog_is_stopped_at_the_prompt() -> None:
    """An ESP32's watchdog cannot be stopped: it gets a day or more instead."""
    port, _ = make_port()
    feed = port.watch(5000)  # ms
    clock.work(4_000_000)  # us
    feed()
    clock.work(6_000_000)
    with pytest.raises(RuntimeError, match="started anew"):
        feed()
    esp_machine.WDT.fed = clock.us  # as after a restart
    assert port.watch(0) is None
    assert esp_machine.WDT.timeout_ms >= 86_400_000


# Edges lost because the scheduler is full


def fill_the_scheduler() -> None:
    """Fill the scheduler, as an engine's timer does during 8 ms of a collection."""
    clock.in_c_code = True
    for _ in range(8):
        clock.call(lambda _: None, None)


def with_lost_edge(change: Any) -> None:
    """Make a change while the scheduler is full, so that the callback of its edge is lost."""
    fill_the_scheduler()
    change()
    clock.in_c_code = False
    clock.advance(clock.us + 10)
    assert clock.lost


@pytest.mark.parametrize(("pin", "who"), [(5, "limits"), (4, "controls"), (35, "controls")])
def test_lost_edge_is_found_at_the_next_poll(pin: int, who: str) -> None:
    """Once for each change, although a closed input is polled again and again."""
    port, calls = make_port()
    with_lost_edge(lambda: Pin(pin).drive(0))
    assert calls == []
    port.poll_inputs()
    assert calls == [who]
    for _ in range(10):
        clock.advance(clock.us + 1000)
        port.poll_inputs()
    assert calls == [who]
    with_lost_edge(lambda: Pin(pin).drive(1))
    port.poll_inputs()
    assert calls == [who, who]


def test_handled_edge_is_not_found_again() -> None:
    """Polling reports nothing that an interrupt has reported already."""
    port, calls = make_port()
    Pin(5).drive(0)  # limit of Y
    Pin(4).drive(0)  # a control input
    for _ in range(10):
        port.poll_inputs()
        clock.advance(clock.us + 1000)
    assert calls == ["limits", "controls"]


def test_disabled_limits_are_not_found_by_polling() -> None:
    """Nor after they are enabled again: only a change counts."""
    port, calls = make_port()
    port.enable_limits(False)
    Pin(5).drive(0)  # limit of Y
    port.poll_inputs()
    port.enable_limits(True)
    port.poll_inputs()
    assert calls == []


def test_lost_debounced_limit_counts_after_it_has_settled() -> None:
    """Polled every millisecond: reported after the third. Pin 5: limit of Y."""
    port, calls = make_port(LIMIT_DEBOUNCE_MS=3)
    with_lost_edge(lambda: Pin(5).drive(0))
    for _ in range(2):
        port.poll_inputs()
        clock.advance(clock.us + 1000)
    assert calls == []
    for _ in range(3):
        port.poll_inputs()
        clock.advance(clock.us + 1000)
    assert calls == ["limits"]


def test_storm_on_one_limit_does_not_delay_another_that_stays_closed() -> None:
    """Limit of X (pin 13) bounces for 6 ms, every millisecond; that of Y (pin 5) is reported
    within this time."""
    port, calls = make_port(LIMIT_DEBOUNCE_MS=3)
    Pin(5).drive(0)
    for level in (0, 1) * 3:
        Pin(13).drive(level)
        port.poll_inputs()
        clock.advance(clock.us + 1000)
    assert "limits" in calls


def test_lost_contact_of_the_probe_is_found() -> None:
    port, _ = make_port()
    contacts: list[bool] = []
    port.watch_probe(lambda: contacts.append(True), closed=True)
    with_lost_edge(lambda: Pin(39).drive(0))  # the probe closes
    assert contacts == []
    port.poll_inputs()
    port.poll_inputs()
    assert contacts == [True]


def test_lost_emergency_stop_is_found() -> None:
    Pin(21, Pin.IN).drive(0)  # closed
    port, calls = make_port(ESTOP=21)
    with_lost_edge(lambda: Pin(21).drive(1))  # its contact opens when pressed
    assert calls == []
    port.poll_inputs()
    assert calls == ["controls"]


def test_lost_input_of_an_extra_is_found() -> None:
    """Input 26 of an extra that has outputs 32 and 33; polling reports it once."""
    port, _ = make_port()
    port.add_pins((32, 33), (25, 26))
    changes: list[bool] = []
    port.watch_pins(lambda: changes.append(True))
    with_lost_edge(lambda: Pin(26).drive(0))
    port.poll_inputs()
    port.poll_inputs()
    assert changes == [True]
