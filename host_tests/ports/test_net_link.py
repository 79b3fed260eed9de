"""The network link: which client controls, which only reads, what each receives, which is
dropped.

A script is a generator that runs at a simulated machine; wait() and until() take ms of its time.
bench.call(address) connects a client; without an address it is this computer, which needs no key.
joined(bench) does that and waits for the welcome, connected(bench, pipe) waits for it. ask() sends
a line and returns its answers; take() returns the text received since the last call.
pipe.has_hung_up and is_broken: the client ends or resets its connection; is_closed: the machine
has closed it; room: bytes of output that it still accepts.
bench.sender is at the cable. bench.steps(): motor steps, 250 per mm. bench.rows: the segments
executed. A client with the key that sends a command has control; after 5 s without commands, while
the machine is idle, another may take it."""

from types import ModuleType

import pytest
from net_bench import KEY, WELCOME, NetBench, connected, joined
from ports.net.net_link import NetLink
from ugrbl.boardfile.files import load_board


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> NetBench:
    return NetBench(monkeypatch)


def test_a_client_is_welcomed_and_takes_control_with_its_first_line(bench) -> None:
    def script(bench):
        """The first line of a trusted client is executed; its report shows the move."""
        pipe = yield from joined(bench)
        answer = yield from bench.ask(pipe, "G1X2F600\n")
        assert answer == "ok\r\n"
        yield from bench.wait(3000)
        pipe.send("?")
        yield from bench.until(lambda: b">" in pipe.got)
        assert "MPos:2.000,0.000" in pipe.take()
        assert bench.sender.take() == []  # the cable's sender has asked nothing

    bench.run(script)
    assert bench.steps() == [500, 0, 0]  # 250 steps/mm * 2 mm


def test_the_cable_sender_gets_its_answers_while_clients_are_connected(bench) -> None:
    def script(bench):
        """The sender at the cable is answered; a client on the network receives nothing of it."""
        pipe = yield from joined(bench)
        yield from bench.sender.wait("ok", "$G\n")
        lines = bench.sender.take()
        assert lines[-1] == "ok" and lines[0].startswith("[GC:")
        yield from bench.sender.wait("report", "?")
        assert bench.sender.take()[0].startswith("<Idle")
        yield from bench.wait(50)
        assert pipe.take() == ""

    bench.run(script)


def test_a_report_goes_only_to_the_client_that_asked(bench) -> None:
    def script(bench):
        """Of two clients only the one that sends "?" receives the status report, "<...>"."""
        silent, asking = bench.call(), bench.call()
        yield from connected(bench, silent)
        yield from connected(bench, asking)
        asking.send("?")
        yield from bench.until(lambda: asking.got.count(b"<") == 1)
        yield from bench.wait(50)
        assert silent.take() == "" and bench.sender.take() == []
        assert asking.take().startswith("<Idle|")

    bench.run(script)


@pytest.mark.parametrize("line", ["$G\n", "$#\n", "$I\n", "$N\n", "$$\n", "$NET\n"])
def test_an_answer_goes_only_to_the_client_that_asked(bench, line: str) -> None:
    def script(bench):
        """Answers to `line` go to one of two clients; only messages, as that of M30, go to all."""
        asking = yield from joined(bench)
        silent = bench.call()
        yield from connected(bench, silent)
        asking.take()
        assert len((yield from bench.ask(asking, line))) > len("ok\r\n")
        assert silent.take() == "" and bench.sender.take() == []
        yield from bench.ask(asking, "M30\n")  # ends a program; its message goes to all
        assert silent.take() == "[MSG:Pgm End]\r\n"

    bench.run(script)


@pytest.mark.parametrize("line", ["G1X1F100\n", "$H\n", "$J=G91X1F100\n", "$110=7\n", "$RST=*\n"])
def test_without_the_key_no_command_is_executed(bench, line: str) -> None:
    def script(bench):
        """Send a command (line) and real-time bytes without the key; error:9 is "locked"."""
        pipe = bench.call("10.0.0.1")
        yield from connected(bench, pipe)
        before = list(bench.store.files["settings"])
        answer = yield from bench.ask(pipe, line)
        assert answer.startswith("[MSG:Read only: ") and answer.endswith("error:9\r\n")
        pipe.send("!\x18~\x84\x90")  # hold, reset, start, door, feed override 100 %
        yield from bench.wait(100)
        assert bench.rig.controller.state.run == 0  # idle: no hold, no door
        assert bench.store.files["settings"] == before

    bench.run(script)
    assert bench.steps() == [0, 0, 0] and bench.rows == []


def test_without_the_key_a_sender_completes_its_start_queries(bench) -> None:
    def script(bench):
        """Without the key, all queries that senders send at their start are answered."""
        pipe = bench.call("10.0.0.1")
        yield from connected(bench, pipe)
        answers = {}
        for line in ("\n", "$I\n", "$$\n", "$G\n", "$#\n", "$N\n", "$\n"):
            answers[line] = yield from bench.ask(pipe, line)
            assert answers[line].endswith("ok\r\n"), (line, answers[line])
        assert answers["$$\n"].count("$") == 34  # the number of Grbl's settings
        assert "[VER:1.1h" in answers["$I\n"]

    bench.run(script)


def test_with_the_key_commands_are_executed_and_each_connection_must_send_it(bench) -> None:
    def script(bench):
        """Send the key in lower case; a second connection from the same address needs it again."""
        pipe = bench.call("10.0.0.1")
        yield from connected(bench, pipe)
        assert (yield from bench.ask(pipe, f"$net/key={KEY.lower()}\n")) == "ok\r\n"
        assert (yield from bench.ask(pipe, "G1X1F600\n")) == "ok\r\n"
        pipe.has_hung_up = True
        second_connection = bench.call("10.0.0.1")
        yield from connected(bench, second_connection)
        assert (yield from bench.ask(second_connection, "G1X2\n")).endswith("error:9\r\n")
        assert (yield from bench.ask(second_connection, f"$NET/KEY={KEY}\n")) == "ok\r\n"
        assert (yield from bench.ask(second_connection, "G1X2\n")) == "ok\r\n"
        yield from bench.wait(2000)

    bench.run(script)
    assert bench.steps() == [500, 0, 0]  # 250 steps/mm * 2 mm


def test_a_machine_without_a_key_trusts_no_client(bench) -> None:
    def script(bench):
        bench.rig.link.access.secret = ""  # no key is stored
        pipe = bench.call("10.0.0.1")
        yield from connected(bench, pipe)
        assert (yield from bench.ask(pipe, "$NET/KEY=\n")).endswith("error:9\r\n")

    bench.run(script)


def test_lines_of_two_clients_are_never_mixed(bench) -> None:
    def script(bench):
        """While one client controls, lines of another and of the cable are refused."""
        controlling, other = bench.call(), bench.call()
        yield from connected(bench, controlling)
        yield from connected(bench, other)
        assert (yield from bench.ask(controlling, "G1X5F300\n")) == "ok\r\n"
        answer = yield from bench.ask(other, "G1Y5F300\n")
        assert answer == "[MSG:Another has control]\r\nerror:9\r\n"
        yield from bench.sender.wait("ok", "G1Z5F300\n")
        lines = bench.sender.take()
        assert "[MSG:Another has control]" in lines and lines[-1] == "error:9"
        yield from bench.wait(3000)

    bench.run(script)
    assert bench.steps() == [1250, 0, 0]  # 250 steps/mm * 5 mm: only X5


def test_another_client_may_take_control_if_the_first_is_silent_and_the_machine_idle(
    bench,
) -> None:
    def script(bench):
        """After 6 s without a line of the first client, the second takes control with its line;
        the first is notified."""
        first, second = bench.call(), bench.call()
        yield from connected(bench, first)
        yield from connected(bench, second)
        assert (yield from bench.ask(first, "G1X1F600\n")) == "ok\r\n"
        for _ in range(6):
            first.send("?")  # a status request is not a line
            yield from bench.wait(1000)
        first.take()
        assert (yield from bench.ask(second, "G1X2\n")) == "ok\r\n"
        assert "[MSG:Another has control]" in first.take()
        yield from bench.wait(1000)

    bench.run(script)
    assert bench.steps() == [500, 0, 0]  # 250 steps/mm * 2 mm


@pytest.mark.parametrize("byte", ["!", "\x18", "\x84", "\x85"])
@pytest.mark.parametrize("by", ["cable", "key"])
def test_stops_act_from_any_trusted_client_during_anothers_control(
    bench, byte: str, by: str
) -> None:
    """byte: feed hold, reset, door, jog cancel (\\x85 acts on jogs only). by: who sends it, the
    cable or another client with the key. A client without the key (stranger) stops nothing."""

    def script(bench):
        """Send a stop (byte) while another client moves the machine: without the key it does
        nothing, from the cable or from a client with the key (by) it stops the motion."""
        stranger = bench.call("10.0.0.1")
        yield from connected(bench, stranger)
        yield from bench.ask(stranger, "$$\n")  # reading does not give it control
        controlling, other_trusted = (yield from joined(bench)), (yield from joined(bench))
        line = "$J=G91X50F300\n" if byte == "\x85" else "G1X50F300\n"
        assert (yield from bench.ask(controlling, line)) == "ok\r\n"
        yield from bench.wait(500)
        stranger.send(byte + "~")
        yield from bench.wait(500)
        assert bench.rig.moving()
        (bench.rig.link.cable if by == "cable" else other_trusted).send(byte.encode("latin-1"))
        yield from bench.wait(1500)
        assert not bench.rig.moving()

    bench.run(script)
    assert 0 < bench.steps()[0] < 12500  # 250 steps/mm * 50 mm would be the end of the move


@pytest.mark.parametrize("byte", ["!", "\x18", "\x84"])
def test_stops_act_while_another_client_floods_its_connection(bench, byte: str) -> None:
    def script(bench):
        """A stop (byte) acts although the client in control sends 100 kB at once."""
        flooding, stopping = (yield from joined(bench)), (yield from joined(bench))
        assert (yield from bench.ask(flooding, "G1X50F300\n")) == "ok\r\n"
        flooding.send("?" * 100_000)
        stopping.send(byte)
        yield from bench.wait(1000)
        assert not bench.rig.moving()
        flooding.is_broken = True  # the connection is reset: the flood ends

    bench.run(script)


@pytest.mark.parametrize("by", ["cable", "key"])
def test_lines_before_a_reset_are_dropped_with_the_clients_own_reset(bench, by: str) -> None:
    def script(bench):
        """A line and Ctrl-X arrive in one packet from a client that is not yet in control: the
        line is dropped, as from a client in control. The next line is executed."""
        pipe = yield from joined(bench)
        client = bench.rig.link.cable if by == "cable" else pipe
        client.send(b"G91G0X50\n\x18")
        yield from bench.wait(2000)
        assert bench.steps() == [0, 0, 0] and "Grbl" in pipe.take()
        client.send(b"G0X1\n")
        yield from bench.wait(2000)

    bench.run(script)
    assert bench.steps() == [250, 0, 0]


def test_a_client_that_only_reads_is_never_in_control(bench) -> None:
    def script(bench):
        """Queries without the key give no control while nobody has it. While another client has
        it, even a silent one, they are refused."""
        stranger = bench.call("10.0.0.1")
        yield from connected(bench, stranger)
        for _ in range(3):
            assert (yield from bench.ask(stranger, "$G\n")).endswith("ok\r\n")
            assert bench.rig.link.control.driver is None
        controlling = yield from joined(bench)
        assert (yield from bench.ask(controlling, "G1X1F600\n")) == "ok\r\n"
        yield from bench.wait(7000)  # idle, and silent
        assert (yield from bench.ask(stranger, "$G\n")).endswith("error:9\r\n")
        assert "Another has" not in controlling.take()

    bench.run(script)


def test_a_half_line_of_a_closed_connection_is_discarded(bench) -> None:
    def script(bench):
        """A part of a line ("G1X9") of a client that has gone must not become "G1X9Y1" with the
        next client's line."""
        closed = yield from joined(bench)
        assert (yield from bench.ask(closed, "G1X1F600\n")) == "ok\r\n"
        closed.send("G1X2\nG1X9")
        yield from bench.wait(30)
        closed.has_hung_up = True
        next_client = yield from joined(bench)
        assert (yield from bench.ask(next_client, "Y1\n")) == "ok\r\n"
        yield from bench.wait(3000)

    bench.run(script)
    assert bench.steps() == [500, 250, 0]  # the complete line was executed


def test_answers_to_a_closed_connection_go_to_no_other_client(bench) -> None:
    def script(bench):
        """Three lines of a client that has gone are executed after the next client has
        connected; only the answers to its own lines go to that."""
        closed = yield from joined(bench)
        closed.send("G4P2\nG1X1F600\nG1X2\n")  # a dwell of 2 s: no answer before it closes
        yield from bench.wait(100)
        closed.has_hung_up = True
        yield from bench.wait(50)
        next_client = yield from joined(bench)
        next_client.send("G1X3\nG1X4\n?")
        yield from bench.until(lambda: b"<" in next_client.got)  # the report comes at once
        yield from bench.wait(4000)
        assert next_client.take().count("ok\r\n") == 2  # of its own two lines only

    bench.run(script)
    assert bench.steps() == [1000, 0, 0]  # X4: the lines of both are executed


def test_a_jog_ends_when_its_client_disconnects_and_a_program_continues(bench) -> None:
    def script(bench):
        """A jog stops when its connection breaks, since nobody could cancel it. A move of a
        program is executed to its end."""
        jogging = yield from joined(bench)
        assert (yield from bench.ask(jogging, "$J=G91X50F300\n")) == "ok\r\n"
        yield from bench.wait(500)
        jogging.is_broken = True
        yield from bench.wait(1500)
        assert not bench.rig.moving()
        steps_at_stop = bench.steps()[0]
        assert 0 < steps_at_stop < 5000  # 250 * 50 = 12500 would be all of the jog
        programming = yield from joined(bench)
        assert (yield from bench.ask(programming, "G91G1X4F600\n")) == "ok\r\n"
        programming.is_broken = True
        yield from bench.wait(3000)
        assert bench.steps()[0] == steps_at_stop + 1000  # 250 steps/mm * 4 mm, all of the program

    bench.run(script)


def test_jogs_that_wait_end_with_their_client(bench) -> None:
    def script(bench):
        """Of 25 jogs some fill the planner, one waits for space there, and the others are in the
        receive buffer: none is executed after their connection has broken."""
        jogging = yield from joined(bench)
        jogging.send("$J=G91X5F600\n" * 25)
        yield from bench.wait(1000)
        jogging.is_broken = True
        yield from bench.wait(1500)
        steps_at_stop = bench.steps()
        yield from bench.wait(3000)
        # at F600 about 2500 steps/s
        assert bench.steps() == steps_at_stop and 1000 < steps_at_stop[0] < 5000

    bench.run(script)


@pytest.fixture
def with_job(monkeypatch, tmp_path):
    """Return a bench whose machine has a job of 60 lines; line 31 is a dwell of 2 s."""
    board = ModuleType("board")
    vars(board).update(vars(load_board("sim_wifi")), JOBS=str(tmp_path))
    lines = ["G21G91", *["G1X0.10Y0.20F3000"] * 29, "G4P2", *["G1X0.10Y0.20"] * 28, "M2"]
    (tmp_path / "A.NC").write_text("\n".join(lines) + "\n")
    return NetBench(monkeypatch, {110: 3000, 111: 3000, 120: 500, 121: 500}, board=board)


_JOB_STEPS = [57 * 25, 57 * 50, 0]  # 57 moves of 0.1 and 0.2 mm


@pytest.mark.parametrize("lost_ms", range(100, 2300, 157))
@pytest.mark.parametrize("partial_line", ["", "G1X9"])
def test_lines_of_a_job_are_executed_whole_whoever_comes_and_goes(
    with_job, lost_ms: int, partial_line: str
) -> None:
    def script(bench):
        """Start a job from a client, lose that client lost_ms later after partial_line, and let
        a client without the key come and go: the job is not disturbed."""
        starter = yield from joined(bench)
        assert (yield from bench.ask(starter, "$F=A.NC\n")).startswith("ok")
        yield from bench.wait(lost_ms)
        starter.send(partial_line)
        stranger = bench.call("10.0.0.66")
        yield from bench.wait(20)
        stranger.send("$G\n")
        yield from bench.wait(20)
        starter.is_broken = stranger.has_hung_up = True
        yield from bench.wait(6000)

    with_job.run(script)
    assert with_job.steps() == _JOB_STEPS


def test_line_of_a_client_that_takes_control_during_a_job_is_refused(with_job) -> None:
    def script(bench):
        """A job ($F=) runs, and the client that started it has gone: lines of another are
        refused."""
        starter = yield from joined(bench)
        assert (yield from bench.ask(starter, "$F=A.NC\n")).startswith("ok")
        yield from bench.wait(1500)  # in the dwell
        starter.has_hung_up = True
        yield from bench.wait(100)
        next_client = yield from joined(bench)
        next_client.send("G1X20F3000\n")
        yield from bench.wait(6000)
        assert "error:9\r\n" in next_client.take()

    with_job.run(script)
    assert with_job.steps() == _JOB_STEPS


@pytest.mark.parametrize("start", ["A10", "<Idle|", "\n", "[MSG:", "ok", "error:9"])
def test_the_text_of_a_job_goes_only_to_the_client_that_asked(
    with_job, tmp_path, start: str
) -> None:
    """Pieces of 128 bytes of the file begin with `start`, like output for other clients."""
    text = f"{start:x<128}" * 3
    (tmp_path / "T.NC").write_text(text)

    def script(bench):
        """One of three clients shows the job ($F<=)."""
        asking, watching = (yield from joined(bench)), (yield from joined(bench))
        stranger = bench.call("10.0.0.66")
        yield from connected(bench, stranger)
        bench.sender.take(), watching.take(), asking.take()
        asking.send("$F<=T.NC\n")
        yield from bench.wait(500)
        assert asking.take() == text + "\r\nok\r\n"
        assert watching.take() == stranger.take() == "" and bench.sender.take() == []

    with_job.run(script)


def test_a_reconnected_client_can_resume_a_moving_machine(bench) -> None:
    def script(bench):
        """A new connection may hold ("!") at once, but resume ("~") only once the controlling
        one has been silent for 3 s."""
        first_connection = yield from joined(bench)
        assert (yield from bench.ask(first_connection, "G1X5F600\n")) == "ok\r\n"
        yield from bench.wait(100)
        # Wi-Fi is lost: no bytes come, and the machine is not notified.
        second_connection = yield from joined(bench)
        second_connection.send("!")
        yield from bench.wait(100)
        second_connection.send("~")
        yield from bench.wait(100)
        assert bench.rig.controller.state.run == 16  # HOLD: the first client may be there
        yield from bench.wait(3000)
        second_connection.send("~")
        yield from bench.wait(2000)

    bench.run(script)
    assert bench.steps() == [1250, 0, 0]  # 250 steps/mm * 5 mm, all of the move


def test_a_client_that_does_not_read_is_dropped_without_blocking_others(bench) -> None:
    def script(bench):
        """A client requests 40 long answers, but its connection takes 100 bytes only: it is
        dropped, and the cable is answered."""
        pipe = yield from joined(bench)
        pipe.room = 100
        before = bench.rig.now
        for _ in range(40):
            pipe.send("$$\n")
            yield from bench.wait(10)
        yield from bench.until(lambda: pipe.is_closed, 5000)
        assert bench.rig.now - before < bench.rig.ticks_per_ms * 3000  # dropped within 3 s
        yield from bench.sender.wait("ok", "\n")

    bench.run(script)


def test_output_to_a_silent_client_stays_within_memory(bench) -> None:
    def script(bench):
        """A client that sends nothing does not prove that it has read: it is dropped before the
        output to it fills the memory of the network stack."""
        pipe = yield from joined(bench)
        for _ in range(100):
            yield from bench.sender.wait("ok", "M30\n")  # its message goes to all
            yield from bench.wait(20)
        assert pipe.is_closed and 10 < pipe.got.count(b"Pgm End") <= 24  # 2400 bytes, 100 each

    bench.run(script)


def test_random_bytes_without_the_key_do_nothing(bench) -> None:
    def script(bench):
        """Each byte value, then a long line, from a client without the key."""
        pipe = bench.call("10.0.0.1")
        yield from connected(bench, pipe)
        pipe.send(bytes(range(256)) * 40)
        # telnet options, and a line much too long
        pipe.send(b"\xff\xfb\x18\xff\xfd\x03" * 50 + b"G" * 5000 + b"\n")
        yield from bench.wait(3000)
        assert bench.rig.controller.state.run == 0

    bench.run(script)
    assert bench.rows == []


def test_ctrl_c_over_the_network_never_leads_to_the_prompt(bench) -> None:
    """Ctrl-C three times, or Ctrl-C and Ctrl-A, would open the MicroPython prompt at the cable."""

    def script(bench):
        pipe = yield from joined(bench)
        assert (yield from bench.ask(pipe, "\x03\x03\x03\x01$G\n")).endswith("ok\r\n")

    bench.run(script)


def test_the_cable_is_read_directly_after_the_last_client_has_gone(bench) -> None:
    def script(bench):
        """link._is_plain: there is no client, so the bytes of the cable need no check of who
        controls."""
        link = bench.rig.link
        assert link._is_plain
        pipe = yield from joined(bench)
        assert not link._is_plain
        assert (yield from bench.ask(pipe, "G1X1F600\n")) == "ok\r\n"
        pipe.has_hung_up = True
        yield from bench.until(lambda: link._is_plain)
        yield from bench.sender.wait("ok", "G1X2\n")
        yield from bench.wait(1000)

    bench.run(script)
    assert bench.steps() == [500, 0, 0]


def test_only_the_cable_is_greeted_when_its_port_is_opened(bench) -> None:
    """The cable's own link reports the opening and asks for the welcome
    (ports/usb/usb_link.py). Here the next read of the cable does that, by the callback that
    attach() was passed."""

    def script(bench):
        """The port of the cable is opened (the next read of the cable reports it): the welcome
        goes to the cable, not to a client on the network."""
        pipe = yield from joined(bench)
        machine, link = bench.rig.controller, bench.rig.link
        NetLink.attach(link, machine.at_rest, machine.welcome)
        read_cable = link._read_cable

        def read(buf: bytearray) -> int:
            link._read_cable = read_cable
            link.cable.attached[1]()  # the callback that asks for the welcome
            return read_cable(buf)

        link._read_cable = read
        yield from bench.wait(50)
        assert WELCOME.strip() in bench.sender.take() and pipe.take() == ""
        assert (yield from bench.ask(pipe, "$G\n")).endswith("ok\r\n")

    bench.rig.link.cable.attach = lambda *asked: setattr(bench.rig.link.cable, "attached", asked)
    bench.run(script)


def test_a_client_dropped_in_the_middle_of_its_lines_loses_control(bench) -> None:
    def script(bench):
        """The second client is dropped for not reading the answers to $G, before M9, which would
        give it control, is read. The first can go on at once."""
        first, dropped = bench.call(), bench.call()
        yield from connected(bench, first)
        yield from connected(bench, dropped)
        assert (yield from bench.ask(first, "G1X1F600\n")) == "ok\r\n"
        for _ in range(6):
            first.send("?")  # no line: another client may take control
            yield from bench.wait(1000)
        dropped.room = 0  # it accepts no output
        dropped.send("$G\n" * 17 + "M9\n")
        yield from bench.until(lambda: dropped.is_closed)
        assert (yield from bench.ask(first, "G1X2\n")) == "ok\r\n"

    bench.run(script)


@pytest.mark.parametrize("comment_bytes", [0, 200, 250, 300])
def test_all_lines_of_a_new_client_are_executed_after_those_of_the_last(
    bench, comment_bytes: int
) -> None:
    def script(bench):
        """The dwell of a client that has gone delays the lines of the next one; none is lost, nor
        does a comment that is longer than a client's memory end its reading."""
        last_client = yield from joined(bench)
        last_client.send("G4P1.5\n")  # a dwell of 1.5 s
        yield from bench.wait(100)
        last_client.has_hung_up = True
        new_client = yield from joined(bench)
        comment = f"({'c' * comment_bytes})\n"
        new_client.send("G91\n" + comment + "G1X0.1F600\n" * 11)
        yield from bench.wait(5000)
        assert new_client.take().count("ok\r\n") == 1 + 1 + 11  # G91, the comment, the moves

    bench.run(script)
    assert bench.steps() == [275, 0, 0]  # 250 steps/mm * 11 * 0.1 mm


def test_a_line_begun_at_the_cable_is_not_broken_by_a_connection(bench) -> None:
    def script(bench):
        """Half a line from the cable ("G91 ") and what comes 6 s later are one line, although a
        client connects in between."""
        bench.rig.link.cable.send(b"G91 ")
        yield from bench.wait(6000)  # control is free for a sender that is silent so long
        stranger = bench.call("10.0.0.66")
        yield from bench.wait(100)
        bench.rig.link.cable.send(b"G0 X50\nG90\nG91 G0 X1\n")
        yield from bench.wait(12_000)
        stranger.has_hung_up = True

    bench.run(script)
    assert bench.steps()[0] == 51 * 250


def test_waiting_lines_of_the_cable_are_dropped_when_another_takes_control(bench) -> None:
    def script(bench):
        """A line of the cable waits after the dwell of a client that has gone, until another
        client takes control: it is not executed when the cable is in control again."""
        gone, other = (yield from joined(bench)), (yield from joined(bench))
        gone.send("G4P7\n")
        yield from bench.wait(100)
        gone.has_hung_up = True
        yield from bench.wait(100)
        bench.rig.link.cable.send(b"G91G0X40\n")
        yield from bench.wait(6000)  # the cable is silent so long that control is free
        assert (yield from bench.ask(other, "G91G0X1\n")) == "ok\r\n"
        other.has_hung_up = True
        yield from bench.wait(1000)
        bench.rig.link.cable.send(b"G0X1\n")
        yield from bench.wait(3000)

    bench.run(script)
    assert bench.steps() == [500, 0, 0]  # 250 steps/mm, 1 mm of each client


@pytest.mark.parametrize("number", range(215, 242, 3))
def test_waiting_lines_of_the_cable_are_executed_whole_or_refused(bench, number: int) -> None:
    def script(bench):
        """Lines of the cable wait in 256 bytes after the dwell of a client that has gone; one that
        does not fit is refused (error:11). A comment of `number` bytes makes the space end
        anywhere in a line."""
        gone = yield from joined(bench)
        gone.send("G4P3\n")
        yield from bench.wait(100)
        gone.has_hung_up = True
        yield from bench.wait(100)
        bench.sender.take()
        bench.rig.link.cable.send(b"(" + b"x" * (number - 2) + b")" + b"G91G0X1.0Y1.0\n" * 3)
        yield from bench.wait(2000)
        bench.rig.link.cable.send(b"G91G0X1.0Y1.0\n")
        yield from bench.wait(5000)
        answers = bench.sender.take()
        assert sorted(set(answers)) == ["error:11", "ok"] and len(answers) == 4
        bench.moves = answers.count("ok")

    bench.run(script)
    assert bench.steps() == [250 * bench.moves, 250 * bench.moves, 0]  # 250 steps/mm


def test_network_settings_of_a_client_that_hung_up_are_not_the_cables(bench) -> None:
    def script(bench):
        """A command for a new key waits after a dwell when its client leaves. It must not be
        executed as a line of the cable, which alone may set the key."""
        closed = yield from joined(bench)
        yield from bench.ask(closed, f"$NET/KEY={KEY}\n")
        closed.send("G4P1\n$NET/KEY=NEW\n")
        yield from bench.wait(200)
        closed.has_hung_up = True
        yield from bench.wait(200)
        bench.rig.link.cable.send(b"G0X1\n")
        yield from bench.wait(3000)

    bench.run(script)
    assert bench.store.files["network"] == [f"KEY={KEY}"]


def test_a_long_answer_arrives_complete(bench) -> None:
    def script(bench):
        """The answer to $$ is three times as long here: more than is queued at once."""
        pipe = yield from joined(bench)
        machine = bench.rig.controller
        show_once = machine.commands.show_settings
        machine.commands.show_settings = lambda: [show_once() for _ in range(3)]
        answer = yield from bench.ask(pipe, "$$\n")
        assert answer.count("$") == 3 * 34 and answer.endswith("ok\r\n")  # 34 settings
        assert not pipe.is_closed

    bench.run(script)


def silent_owner_and_other(bench, sends=""):
    """Return a client in control that is silent for 6 s after `sends`, and another client."""
    owner, other = (yield from joined(bench)), (yield from joined(bench))
    yield from bench.ask(owner, "G91G1X1F60000\n")
    owner.send(sends)
    yield from bench.wait(6000)
    return owner, other


def test_a_polling_client_neither_takes_nor_loses_control(bench) -> None:
    def script(bench):
        """A client that only sends queries is answered at any time, but never gets control."""
        owner, polling = (yield from joined(bench)), (yield from joined(bench))
        for k in range(4):
            assert (yield from bench.ask(owner, f"G91G1X{k + 1}F60000\n")) == "ok\r\n"
            yield from bench.wait(6000)  # the owner is silent so long that control is free
            for line in ("$G\n", "$#\n", "$$\n", "$G\n$G\n"):
                answers = yield from bench.ask(polling, line)
                assert "error" not in answers and answers.count("ok\r\n") == line.count("\n")
            assert owner.take() == ""
        # The polling client executed nothing: it does not own the machine.
        assert bench.rig.link.control.owner.conn is owner

    bench.run(script)


def test_a_command_after_a_query_takes_control_and_loses_no_answer(bench) -> None:
    """Control is free, because the owner was silent; the command takes it."""

    def script(bench):
        owner, other = yield from silent_owner_and_other(bench)
        other.send("$G\nG91G1X1\n")
        yield from bench.until(lambda: other.got.count(b"ok\r\n") == 2)
        assert "[GC:" in other.take() and "Another has" in owner.take()

    bench.run(script)


def test_lines_of_the_controlling_client_wait_while_another_reads(bench) -> None:
    def script(bench):
        """Another client has just sent queries (delay_ms ago) when the owner sends lines:
        all lines are executed, and answered to the client that sent them."""
        owner, reading = (yield from joined(bench)), (yield from joined(bench))
        for delay_ms in range(15):
            yield from bench.ask(owner, "G91G1X1F60000\n")
            yield from bench.wait(6000)  # the owner is silent so long that control is free
            owner.take(), reading.take()
            reading.send("$$\n$G\n")
            yield from bench.wait(delay_ms)
            owner.send("G91G1X1F60000\n" * 3)
            yield from bench.until(lambda: owner.got.count(b"ok\r\n") == 3)
            yield from bench.wait(200)
            assert owner.take() == "ok\r\n" * 3
            answers = reading.take()
            # each line is answered, by ok or a refusal
            assert answers.count("ok\r\n") + answers.count("error:9") == 2

    bench.run(script)


def test_a_reader_that_disconnects_does_not_change_control(bench) -> None:
    def script(bench):
        """Another client disconnects while its answer is sent; the owner keeps control."""
        owner, other = yield from silent_owner_and_other(bench)
        other.send("$$\n")
        yield from bench.wait(1)
        other.has_hung_up = True
        yield from bench.wait(50)
        assert (yield from bench.ask(owner, "G1X1\n")) == "ok\r\n"

    bench.run(script)


def test_a_late_answer_goes_to_the_owner_although_another_reads(bench) -> None:
    """The owner waits 7 s for the answer to a dwell."""

    def script(bench):
        owner, other = yield from silent_owner_and_other(bench, "G4P7\n")
        other.send("$G\n")
        yield from bench.until(lambda: b"ok\r\n" in other.got and b"ok\r\n" in owner.got)
        assert owner.take() == "ok\r\n" and "[GC:" in other.take()

    bench.run(script)


def test_a_begun_line_is_not_broken_by_a_reading_client(bench) -> None:
    """Other lines are refused while a line of the owner is incomplete."""

    def script(bench):
        owner, other = yield from silent_owner_and_other(bench, "G1 X")
        assert "error:9" in (yield from bench.ask(other, "$G\n"))
        assert (yield from bench.ask(owner, "1\n")) == "ok\r\n"

    bench.run(script)


def test_a_jog_ends_when_its_client_disconnects_while_another_reads(bench) -> None:
    def script(bench):
        """The jog arrives while the answer to another client is sent, and its own client hangs
        up: the machine is idle soon."""
        owner, other = yield from silent_owner_and_other(bench)
        other.send("$$\n")
        yield from bench.wait(1)
        owner.send("$J=X200F600\n")
        owner.has_hung_up = True
        yield from bench.wait(3000)
        assert bench.rig.controller.at_rest()

    bench.run(script)


def test_a_client_without_the_key_blocks_no_other_client(bench) -> None:
    def script(bench):
        """A client without the key reads the settings at varying times; each of 20 clients with
        the key takes control."""
        stranger, controlling = bench.call("10.0.0.9"), (yield from joined(bench))
        yield from bench.wait(20)
        for k in range(20):
            stranger.send("$$\n")
            yield from bench.wait(k % 5)
            controlling.take()
            assert (yield from bench.ask(controlling, "G91G1X1F60000\n")) == "ok\r\n"
            controlling.has_hung_up = True
            yield from bench.wait(2000)
            controlling = yield from joined(bench)

    bench.run(script)
