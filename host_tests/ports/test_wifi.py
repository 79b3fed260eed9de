"""Wi-Fi: `ugrbl wifi`, `$NET` on the machine, and the radio."""

import binascii
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import network
import pytest
from net_bench import KEY, NetBench
from ports.net import wifi as air
from ports.net.radio import Radio
from typer.testing import CliRunner
from ugrbl.cli.app import app
from ugrbl.device import wifi
from ugrbl.device.connection import SendError


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> NetBench:
    return NetBench(monkeypatch)


def ask_at_cable(bench: NetBench, *lines: str) -> list[str]:
    """Send lines at the cable; return the machine's answers."""
    answers: list[str] = []

    def script(bench: NetBench) -> Iterator[Any]:
        for line in lines:
            yield from bench.sender.wait("ok", line + "\n")
            answers.extend(bench.sender.take())

    bench.run(script)
    return answers


def stored_network(bench: NetBench) -> dict[str, str]:
    """Return the stored network settings by name."""
    rows = (line.partition("=") for line in bench.store.files["network"])
    return {name: value for name, _, value in rows}


def test_the_machine_stores_what_the_tool_sends(bench: NetBench) -> None:
    """A name and a password with characters that Grbl would remove or act upon are sent as
    hexadecimal digits."""
    name, password = "Werk stätte/2,4", "a-Passw0rd!" * 5 + "öhm;("
    wanted = wifi.Wanted(name, password, is_station=True, host="Router-1", port=2300)
    lines = list(wifi.orders(wanted))
    assert max(map(len, lines)) <= 79  # the longest line that Grbl accepts
    answers = ask_at_cable(bench, *lines)
    assert answers.count("ok") == len(lines)
    stored = stored_network(bench)
    assert binascii.unhexlify(stored["SSID"]).decode() == name
    assert binascii.unhexlify(stored["PASS"]).decode() == password
    assert (stored["HOST"], stored["PORT"], stored["MODE"]) == ("router-1", "2300", "station")
    assert stored["KEY"] == KEY


def test_no_answer_contains_the_network_name_or_password(bench: NetBench) -> None:
    """secrets: both also as hexadecimal digits, as they are stored."""
    secrets = ("Workshop", "Workshop".encode().hex().upper(), "hunter22", "68756E74")
    lines = wifi.orders(wifi.Wanted("Workshop", "hunter22", is_station=True))
    answers = ask_at_cable(
        bench, *lines, "$NET", "$$", "$I", "$I+", "$#", "$G", "$N", "$NET/PASS=1"
    )
    assert not [line for line in answers for word in secrets if word in line]
    assert KEY not in "".join(answers)
    # Senders that look for "ok" in a line must find it in answers only.
    for line in answers:
        assert line == "ok" or line.startswith("error:") or "ok" not in line.lower()


@pytest.mark.parametrize(
    "line",
    [
        "$NET/SSID=",
        "$NET/SSID=4",
        "$NET/SSID=XY",
        "$NET/SSID=" + "41" * 33,
        "$NET/PASS",
        "$NET/MODE=AP",
        "$NET/MODE=MESH",
        "$NET/HOST=",
        "$NET/HOST=-A",
        "$NET/HOST=A.B",
        "$NET/HOST=" + "A" * 32,
        "$NET/PORT=0",
        "$NET/PORT=65536",
        "$NET/PORT=A",
        "$NET/ALLOW=1.2.3.4",
        "$NET/KEY=MINE",
        "$NET/WHAT",
    ],
)
def test_an_invalid_setting_changes_nothing(bench: NetBench, line: str) -> None:
    before = list(bench.store.files["network"])
    answers = ask_at_cable(bench, line)
    assert answers[-1] == "error:3" and answers[0].startswith("[MSG:")
    assert bench.store.files["network"] == before


@pytest.mark.parametrize("line", ["$NET/PASS=", "$NET/PASS=41", "$NET/MODE+AP"])
def test_an_access_point_never_loses_its_password(bench: NetBench, line: str) -> None:
    """Names and passwords are sent as hexadecimal digits; a password shorter than 8 bytes is
    refused."""
    ask_at_cable(bench, "$NET/SSID=41", "$NET/PASS=" + "41" * 8, "$NET/MODE=AP")
    before = list(bench.store.files["network"])
    answers = ask_at_cable(bench, line)
    assert answers[-1] == "error:3" and answers[0].startswith("[MSG:")
    assert bench.store.files["network"] == before


def test_after_off_the_next_network_is_joined_and_not_made(bench: NetBench) -> None:
    """An access point is set up and removed by OFF; a later name is that of a network to join."""
    ask_at_cable(bench, "$NET/SSID=41", "$NET/PASS=" + "41" * 8, "$NET/MODE=AP", "$NET/OFF")
    assert ask_at_cable(bench, "$NET/SSID=42")[-1] == "ok"
    assert "MODE" not in stored_network(bench)


@pytest.mark.parametrize("password", ["", "hunter22"])
def test_an_access_point_becomes_a_station_by_the_tool(bench: NetBench, password: str) -> None:
    """A station may join an open network, with an empty password."""
    ask_at_cable(bench, *wifi.orders(wifi.Wanted("Mine", "hunter22" * 2, is_station=False)))
    assert stored_network(bench)["MODE"] == "ap"
    answers = ask_at_cable(bench, *wifi.orders(wifi.Wanted("Ours", password, is_station=True)))
    assert not [line for line in answers if line.startswith("error:")]
    assert (stored_network(bench)["MODE"], stored_network(bench)["PASS"]) == (
        "station",
        password.encode().hex().upper(),
    )


def test_the_network_is_set_up_only_while_idle_and_only_at_the_cable(bench: NetBench) -> None:
    before = list(bench.store.files["network"])

    def script(bench: NetBench) -> Iterator[Any]:
        """A trusted client may read the state of the network ($NET), but not set it up."""
        pipe = bench.call()
        yield from bench.until(lambda: b"Grbl" in pipe.got)
        answer = yield from bench.ask(pipe, "$NET/HOST=evil\n")
        assert answer.endswith("error:3\r\n")
        assert (yield from bench.ask(pipe, "$NET\n")).startswith("[MSG:Network: ")
        assert (yield from bench.ask(pipe, f"$NET/KEY={KEY}\n")) == "ok\r\n"
        assert (yield from bench.ask(pipe, "G1X2F60\n")) == "ok\r\n"
        answer = yield from bench.ask(pipe, "$NET/KEY=NEW\n")
        assert answer.endswith("error:8\r\n")  # not while a move is executed

    bench.run(script)
    assert bench.store.files["network"] == before


def test_a_new_machine_makes_a_key_and_shows_it_once_at_the_cable(bench: NetBench) -> None:
    """All output at the cable is collected (output)."""
    del bench.store.files["network"]  # as on a new machine

    def script(bench: NetBench) -> Iterator[Any]:
        """Reset a new machine while a client is connected: the client does not receive the key,
        and the reset does not show it again."""
        pipe = bench.call()
        yield from bench.until(lambda: b"Grbl" in pipe.got)
        pipe.send("\n")
        bench.rig.link.cable.send(b"\x18")  # reset
        yield from bench.wait(500)
        bench.sender.take()
        assert "key" not in pipe.take()

    take = bench.sender.take
    output: list[str] = []
    bench.sender.take = lambda: output.extend(lines := take()) or lines  # type: ignore[method-assign, func-returns-value]
    bench.run(script)
    key = stored_network(bench)["KEY"]
    assert len(key) == 8 and len(set(key)) > 2
    assert [line for line in output if key in line] == [f"[MSG:Network key: {key}]"]


def test_a_new_key_ends_the_rights_of_the_old_one(bench: NetBench) -> None:
    def script(bench: NetBench) -> Iterator[Any]:
        """A client has sent the key; then the cable makes a new one. The client is
        disconnected, and the old key is refused."""
        pipe = bench.call("10.0.0.1")
        yield from bench.until(lambda: b"Grbl" in pipe.got)
        assert (yield from bench.ask(pipe, f"$NET/KEY={KEY}\n")) == "ok\r\n"
        yield from bench.sender.wait("ok", "$NET/KEY=NEW\n")
        answers = bench.sender.take()
        assert answers[0].startswith("[MSG:Network key: ") and KEY not in answers[0]
        assert pipe.is_closed
        second_connection = bench.call("10.0.0.1")
        yield from bench.until(lambda: b"Grbl" in second_connection.got)
        assert (yield from bench.ask(second_connection, f"$NET/KEY={KEY}\n")).endswith(
            "error:9\r\n"
        )

    bench.run(script)


# The tool


class Board:
    """A board connection with fixed replies."""

    def __init__(self, *replies: str) -> None:
        self.asked: list[str] = []
        self.replies = list(replies)

    def ask(self, line: str) -> list[str]:
        self.asked.append(line)
        return self.replies


def test_a_board_without_a_network_is_reported(bench: NetBench) -> None:
    """An unknown command ($NET) means that the board has no network; otherwise the board's own
    message is shown."""
    board: Any = Board("error:3")
    with pytest.raises(SendError, match='LINK = "wifi"'):
        wifi.status(board)
    board = Board("[MSG:An address is no good]", "error:3")
    with pytest.raises(SendError, match="An address is no good"):
        wifi.set_up(board, ["$NET/ALLOW=x"])


@pytest.mark.parametrize(
    "wanted",
    [
        wifi.Wanted(name="x" * 33),
        wifi.Wanted(name=""),
        wifi.Wanted(password="short"),
        wifi.Wanted(password="x" * 64),
        wifi.Wanted(host="a b"),
    ],
)
def test_an_impossible_name_or_password_is_refused_in_words(wanted: wifi.Wanted) -> None:
    with pytest.raises(ValueError, match=r"bytes|letters"):
        list(wifi.orders(wanted))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--open"], "--name"),
        (["--access-point", "--open", "--name", "x"], "password"),
        (["--off", "--name", "x"], "one of"),
    ],
)
def test_contradicting_options_are_refused(options: list[str], message: str) -> None:
    done = CliRunner().invoke(app, ["wifi", "--port", "/nowhere", *options])
    assert done.exit_code and message in done.output and "Traceback" not in done.output


# The radio


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Return the clock that the radio uses; the network "Shop" is in reach."""
    clock = SimpleNamespace(ms=0)
    monkeypatch.setattr("time.ticks_ms", lambda: clock.ms)
    monkeypatch.setattr(network, "in_reach", {b"Shop": b"secret12"})
    return clock


def test_a_station_reconnects_only_while_idle_and_not_all_the_time(clock: SimpleNamespace) -> None:
    """The network is lost for two minutes; calls: how many times the radio has tried to join,
    the first time at the start."""
    radio = Radio(b"Shop", b"secret12", "router", is_station=True)
    assert network.hostname() == "router"
    assert radio.status() == "station, 192.168.1.7, router.local"
    network.in_reach.clear()
    assert "not connected yet (status -2)" in radio.status()
    # 60 s in motion: no more tries; 60 s idle: one every 15 s
    for at_rest, calls in ((False, 1), (True, 5)):
        for _ in range(60):
            clock.ms += 1000
            radio.poll_radio(at_rest)
        assert radio._wlan.calls == calls
    network.in_reach[b"Shop"] = b"secret12"
    for _ in range(60):
        clock.ms += 1000
        radio.poll_radio(True)
    assert radio._wlan.calls <= 6 and "192.168.1.7" in radio.status()


def test_an_access_point_has_a_name_and_a_password(clock: SimpleNamespace) -> None:
    radio = Radio(b"Own", b"secret12", "router", is_station=False)
    access_point = radio._wlan.asked
    assert (access_point["ssid"], access_point["key"]) == (b"Own", b"secret12")
    assert access_point["security"] == network.WLAN.SEC_WPA_WPA2
    radio.poll_radio(True)
    assert radio.status() == "access point, 192.168.4.1, router.local" and not radio._wlan.calls


def test_the_cable_works_without_a_network_or_with_a_failing_radio(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """First nothing is stored for the network, then a port that is not a number, which raises
    at the start. _calls: None without a network."""
    lines: list[str] = []
    store = SimpleNamespace(load=lambda name: lines)
    monkeypatch.setattr(air, "FlashStore", lambda: store)
    cable: Any = SimpleNamespace(shared=[0, 0, 0], poll_reset=None, is_slow=False)
    cable.read_into = cable.write = lambda data: 0
    link: Any = air.beside(cable)
    assert link._calls is None and link.status() == "no network is set up"
    lines += ["SSID=4142", "PASS=", "PORT=x"]
    link = air.beside(cable)
    assert link._calls is None and link.status().startswith("the Wi-Fi radio failed: ")
    assert link.read_into(bytearray(16)) == 0
