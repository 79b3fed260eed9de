"""Test jobs: programs that are stored on the board and run without a computer.

$F=NAME starts a job, and $F=NAME@LINE at a line within it; $F=@ at the line where a job was
stopped. Bench.run() runs the machine with a script from power-up to its end, and returns the
output. say() is a script that sends lines, and then lets wait_s pass. Bench.moves are the planned
targets in mm, Bench.steps the motors' final steps (250 per mm), and Bench.job_record() is the
stored record of a job: its name, its line, and more. sender.wait(how, text) sends a text and
waits: "ok" until each of its lines is answered, "banner" until the welcome.
"""

import random
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from base.state import CHECK, HOLD
from language.block_layout import MOVE
from motion.layout import SYSTEM_MOTION
from ports.storage.job_files import JobFiles
from ugrbl.boardfile.files import load_board
from ugrbl.device import jobs
from ugrbl.sim import switches
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import MemoryStore, Rig
from ugrbl.sim.sender import Sender

Script = Callable[["Bench"], Iterator[Any]]

_PIECE = 2048  # bytes of a file in one piece of an upload


class Bench:
    """A simulated machine with a folder of jobs, and a sender; options: of the board file."""

    def __init__(self, folder: Path, store: "MemoryStore | None" = None, **options: Any) -> None:
        """folder: holds the job files.

        store: settings of an earlier machine, None: of a new one.
        """
        board = ModuleType("board")
        vars(board).update(vars(load_board("sim")), JOBS=str(folder / "jobs"), **options)
        self.folder = folder / "jobs"
        self.store = store or factory_store(load_board("sim"))
        self.rig = Rig(board, self.store)
        self.sender = Sender(self.rig)
        self.sender.allow(36_000_000)  # ms; then waits fail
        self.steps: list[int] = []  # at the end
        self.moves: list[tuple[float, ...]] = []  # planned targets
        self.log: list[tuple[int, Any]] = []  # arguments of all moves, by lines of the job
        self.rig.on_built = self._listen

    def _listen(self) -> None:
        """Record all moves that are planned, with their line in the job (0: not from a job)."""
        machine = self.rig.controller
        machine.interpreter.watch(MOVE)  # otherwise the kernel would handle some moves
        planner, canon = machine.planner, machine.canon
        call_line, call_arc = planner.line, canon.arc
        link: Any = machine.protocol.link

        def record(*arguments: Any) -> None:
            self.log.append((link.line() + 1 if link.is_on else 0, arguments))

        def line(target: Any, move: Any, power: int) -> bool:
            """Record a planned line, unless it is the system's own; then plan it."""
            if not move.flags & SYSTEM_MOTION:
                self.moves.append(tuple(round(mm, 3) for mm in target))
                flags = move.flags, move.feed, move.spindle_rpm
                record(flags, power, tuple(target), tuple(planner.position))
            return call_line(target, move, power)

        def arc(start: Any, target: Any, arc: Any, move: Any) -> None:
            record(move.flags, move.feed, tuple(start), tuple(target), sorted(vars(arc).items()))
            call_arc(start, target, arc, move)

        planner.line = line  # type: ignore[method-assign]
        canon.arc = arc  # type: ignore[method-assign]

    def put(self, name: str, *lines: str, end: str = "\n") -> None:
        """Write a file as if it had been sent."""
        self.folder.mkdir(exist_ok=True)
        (self.folder / name).write_bytes("".join(line + end for line in lines).encode())

    def run(self, script: Script) -> list[str]:
        """Run the machine with a script from power-up; return the output, without the welcome."""
        output: list[str] = []

        def whole_script() -> Iterator[Any]:
            """Wait for the welcome, run the script; keep output and final steps."""
            yield from self.sender.wait("banner", "")
            yield self.rig.ms(100)  # what follows the welcome is received
            yield from script(self)
            output.extend(self.sender.take())
            # position() writes the steps into its argument.
            self.rig.engine.position(self.rig.scratch)
            self.steps = list(self.rig.scratch)

        self.rig.run(whole_script())
        return [line for line in output if line and not line.startswith("Grbl ")]

    def press(self) -> None:
        """Press and release the start button."""
        for closed in (True, False):
            self.rig.port.push({"start": closed})

    def moves_from(self, line: int) -> list[tuple[int, Any]]:
        """Return the log from a line of the job on."""
        return [entry for entry in self.log if entry[0] >= line]

    def job_record(self) -> list[str]:
        """Return the stored record of the job."""
        return self.store.files.get("job", [])


def say(*lines: str, wait_s: float = 60) -> Script:
    """Send each line after the answer to the one before, and give a job time to end."""

    def script(bench: Bench) -> Iterator[Any]:
        """Send the lines one by one, each after an answer; then wait."""
        sender = bench.sender
        for line in lines:
            before = sender.answers
            bench.rig.link.send(line.encode() + b"\n")
            yield from sender.until(lambda before=before: sender.answers > before)
        yield bench.rig.ms(1000 * wait_s)

    return script


def until_job_ends(*lines: str) -> Script:
    """Do as say(), but only until the job that the last line starts has ended."""

    def has_ended(text: str) -> bool:
        return text.startswith("[MSG:Job ") and not (" begins" in text or " continues at " in text)

    def script(bench: Bench) -> Iterator[Any]:
        """Send the lines; resume each pause of the job, until its end is reported."""
        sender = bench.sender
        yield from say(*lines, wait_s=0)(bench)
        while not any(map(has_ended, sender.lines)):
            if bench.rig.controller.state.run == HOLD:
                bench.rig.link.send(b"~")  # M0, or M6 of a lenient board
            yield bench.rig.ms(50)
            sender.poll()

    return script


def steps_if_streamed(folder: Path, lines: Sequence[str]) -> list[int]:
    """Return the final steps of a sender that streams these lines."""
    bench = Bench(folder)
    bench.run(say(*lines))
    return bench.steps


PROGRAM = ("G21G91", "G1X10F1200 (really? {~!}: 5\xb5m)", "", "Y5 ; done!", "Z-1")


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_job_does_the_same_as_streamed_lines(tmp_path: Path, end: str) -> None:
    """Comments with real-time characters, empty lines and either line end change nothing."""
    bench = Bench(tmp_path)
    bench.put("CUBE.NC", *PROGRAM, end=end)
    output = bench.run(say("$F=cube.nc"))
    assert output == ["ok", "[MSG:Job CUBE.NC: begins]", "[MSG:Job CUBE.NC: done, 5 lines]"]
    assert bench.steps == steps_if_streamed(tmp_path, ("G21G91", "G1X10F1200", "Y5", "Z-1"))
    assert bench.job_record() == []  # a finished job leaves no record


def test_last_line_without_an_end_is_executed(tmp_path: Path) -> None:
    """The file ends with G0X2, without a line end."""
    bench = Bench(tmp_path)
    # This makes the folder.
    bench.put("A.NC", "G0X1")
    (bench.folder / "A.NC").write_bytes(b"G0X1\nG0X2")
    assert bench.run(say("$F=A.NC"))[-1] == "[MSG:Job A.NC: done, 2 lines]"
    assert bench.moves[-1][0] == 2


def test_lines_after_the_program_end_are_not_executed(tmp_path: Path) -> None:
    """M30 ends the program; G0X9 comes after it."""
    bench = Bench(tmp_path)
    bench.put("A.NC", "G0X1", "M30", "%", "G0X9")
    output = bench.run(say("$F=A.NC"))
    assert output[-2:] == ["[MSG:Pgm End]", "[MSG:Job A.NC: done, 2 lines]"]
    assert bench.moves[-1][0] == 1


def test_jobs_are_listed_shown_and_deleted(tmp_path: Path) -> None:
    """$F lists, $F<= shows and $FD= deletes a file; names match in either case."""
    bench = Bench(tmp_path)
    bench.put("B.NC", "G0X1")
    bench.put("a.nc", "G0X2", "G0X3")
    bench.put(".hidden", "G0X9")
    output = bench.run(say("$F", "$F<=A.NC", "$FD=A.NC", "$F", wait_s=0))
    files = ["[FILE:/B.NC|SIZE:5]", "[FILE:/a.nc|SIZE:10]"]
    # A shown file has its own line ends, which do not split the output.
    answers = [line for line in output if not line.startswith("[MSG:Free space: ")]
    assert answers == [*files, "ok", "G0X2\nG0X3\n", "ok", "ok", files[0], "ok"]


@pytest.mark.thorough
def test_words_of_fluidnc_do_the_same(tmp_path: Path) -> None:
    """FluidNC's commands list, show, run and delete; Run without a name is refused."""
    bench = Bench(tmp_path)
    bench.put("B.NC", "G0X1")
    lines = ("$SD/List", "$LocalFS/Show=B.NC", "$LocalFS/Run=B.NC", "$SD/Delete=B.NC", "$SD/Run")
    output = bench.run(say(*lines[:3]))
    assert output[0] == "[FILE:/B.NC|SIZE:5]"
    assert output[-1] == "[MSG:Job B.NC: done, 1 lines]"
    assert bench.run(say(*lines[3:]))[-2:] == ["ok", "error:3"]
    assert not list(bench.folder.iterdir())


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("$F=NONE.NC", "[MSG:There is no job NONE.NC: $F lists them]"),
        # The name may not hold "OK", which a sender could take for an answer.
        ("$FD=BOOK.NC", "[MSG:There is no job BOO-K.NC: $F lists them]"),
        ("$F<=", "[MSG:There is no job : $F lists them]"),
        ("$FD=", "[MSG:There is no job : $F lists them]"),
        ("$FX=A.NC", ""),
        ("$FA", ""),
        ("$SD/Format=1", ""),
    ],
)
def test_impossible_request_is_refused_with_the_reason(
    tmp_path: Path, line: str, answer: str
) -> None:
    """$F=, $F< and $FD= run, show and delete a job. Unknown commands have no message."""
    bench = Bench(tmp_path)
    bench.put("my photo.jpg", "")  # no job can have this name
    output = bench.run(say(line, wait_s=0))
    assert output[-1] == "error:3"
    assert output[:-1] == ([answer] if answer else [])
    assert (bench.folder / "my photo.jpg").exists()


# Failures, and other clients during a job


class Torn:
    """A file on a card that is removed after its first block."""

    def __init__(self, file: Any) -> None:
        self._file = file
        self.tell, self.seek, self.close = file.tell, file.seek, file.close
        self.read = file.read  # its content is checked before the start, with the card still there

    def readinto(self, block: bytearray) -> int:
        if self._file.tell():
            raise OSError(5)
        return int(self._file.readinto(block))


def test_half_a_line_is_not_executed_if_the_rest_cannot_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the first block of the file can be read, and it ends within the number of Z15.

    If its half were executed, Z would move to 1.
    """
    open_file = JobFiles.open
    monkeypatch.setattr(JobFiles, "open", lambda files, name: Torn(open_file(files, name)))
    bench = Bench(tmp_path)
    block_bytes, line = 512, "G0X10Z15"
    # A comment fills the block up to all but the last character of the second line.
    first_line = "G0X5" + "(" + "-" * (block_bytes - len("G0X5()\n" + line) + 1) + ")"
    bench.put("A.NC", first_line, line, "G0X20", "M30")
    assert bench.run(say("M3S500", "$F=A.NC"))[-1] == "[MSG:Job A.NC: line 2 cannot be read]"
    assert [target[0] for target in bench.moves] == [5]
    assert bench.rig.port.spindle_pwm == 0  # M3 before the job was on


def test_refused_line_ends_the_job_with_its_number_and_the_tool_off(tmp_path: Path) -> None:
    """G5 is unsupported (error 20). The M3 before it must not stay on."""
    bench = Bench(tmp_path)
    bench.put("A.NC", "M3S1000", "G91", "G1X5F1200", "G1X5", "G5 X1", "G1X90")
    output = bench.run(say("$F=A.NC", "$G"))
    assert "[MSG:Job A.NC: line 5 is refused with 20]" in output
    assert bench.moves[-1][0] == 10  # of lines 3 and 4
    assert bench.rig.port.spindle_pwm == 0
    assert bench.job_record()[:2] == ["A.NC", "5"]  # the record: name and line


def test_tool_is_off_after_a_file_that_does_not_say_so(tmp_path: Path) -> None:
    """The end of a file turns spindle and coolant off, even without M5, M9 or M30.

    Nobody may be near the machine, because a start button can start the job.
    """
    bench = Bench(tmp_path)
    bench.put("A.NC", "M3S1000M8", "G91", "G1X5F1200")
    output = bench.run(say("$F=A.NC", "$G"))
    assert any(" M5 M9 " in line for line in output)
    assert bench.rig.port.spindle_pwm == bench.rig.port.flood == 0


def test_tool_is_off_after_a_file_that_enters_check_mode(tmp_path: Path) -> None:
    """$C begins check mode."""
    bench = Bench(tmp_path)
    bench.put("A.NC", "M3S1000M8", "G1X5F1200", "$C")

    def script(bench: Bench) -> Iterator[Any]:
        yield from until_job_ends("$F=A.NC")(bench)
        assert bench.rig.controller.state.run == CHECK
        assert bench.rig.port.spindle_pwm == bench.rig.port.flood == 0

    bench.run(script)


def test_alarm_refuses_a_job(tmp_path: Path) -> None:
    """$22=1 requires homing from the next start on; error 9 is the answer in alarm."""
    bench = Bench(tmp_path)
    bench.put("A.NC", "G0X1")
    # With homing enabled, the next start is in alarm.
    assert bench.run(say("$22=1", "$RST=#", wait_s=0))
    assert bench.run(say("$F=A.NC"))[-1] == "error:9"
    assert bench.moves == []


def test_job_in_check_mode_moves_nothing(tmp_path: Path) -> None:
    """$C is check mode: lines are read and checked only."""
    bench = Bench(tmp_path)
    bench.put("A.NC", "G0X10", "G1X20F100")
    output = bench.run(say("$C", "$F=A.NC"))
    assert output[-1] == "[MSG:Job A.NC: done, 2 lines]"
    assert bench.steps == [0, 0, 0]


LONG = ("G91", *["G1X1F600"] * 40)  # of 100 ms each


def test_sender_gets_the_progress_and_its_lines_are_refused(tmp_path: Path) -> None:
    """During a job, reports show its progress, and queries are answered.

    Motion, jogs and settings are refused. A line that the sender has begun is completed after the
    job.
    """
    bench = Bench(tmp_path)
    bench.put("A.NC", *LONG)

    def script(bench: Bench) -> Iterator[Any]:
        """Start the job; send lines that are refused; complete a line after its end."""
        yield from bench.sender.wait("ok", "$F=A.NC\n")
        yield bench.rig.ms(1000)  # the job runs
        bench.sender.take()
        yield from bench.sender.wait("report", "?")
        assert "|SD:100.0,/A.NC>" in bench.sender.lines[0]  # the whole file is read
        bench.sender.take()
        # The six lines, of which one is empty, have six answers.
        yield from bench.sender.wait("ok", "$G\n\n$N\nG0X99\n$J=G91X1F100\n$110=5\n")
        answers = bench.sender.take()
        assert answers[0].startswith("[GC:G1 ")
        assert answers[1:3] == ["ok", "ok"]
        # After the lines of $N: its ok, and the answers to G0, $J and $110.
        assert answers[3:] == ["$N0=", "$N1=", "ok", "error:9", "error:8", "error:8"]
        bench.rig.link.send(b"G1 X")  # the rest of the line follows after the job
        yield bench.rig.ms(9000)  # the job ends
        yield from bench.sender.wait("ok", "7F600\n")
        yield bench.rig.ms(3000)  # until 7 mm are moved

    output = bench.run(script)
    assert output == ["[MSG:Job A.NC: done, 41 lines]", "ok"]
    assert bench.moves[-1][0] == 47  # 40 mm of the job and 7 mm


def test_line_sent_after_the_start_command_comes_first(tmp_path: Path) -> None:
    """A line that arrived together with the start command is executed before the job."""
    bench = Bench(tmp_path)
    bench.put("A.NC", "G0X5")

    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.sender.wait("ok", "$F=A.NC\nG0Y1\n")
        yield bench.rig.ms(5000)  # the job ends

    assert bench.run(script)[-1] == "[MSG:Job A.NC: done, 1 lines]"
    assert bench.moves == [(0, 1, 0), (5, 1, 0)]


def test_hold_stores_the_line_and_a_cycle_start_resumes(tmp_path: Path) -> None:
    """The line in which the hold stopped is stored; ~ continues it."""
    bench = Bench(tmp_path)
    bench.put("A.NC", *LONG)

    def script(bench: Bench) -> Iterator[Any]:
        """Hold (!) in the job; compare the stored line with the position; resume (~)."""
        yield from bench.sender.wait("ok", "$F=A.NC\n")
        yield bench.rig.ms(1650)  # in a line in the middle
        bench.rig.link.send(b"!")
        yield bench.rig.ms(1000)  # until it has stopped
        # position() writes the steps into its argument; 250 steps/mm, and each line is 1 mm.
        bench.rig.engine.position(bench.rig.scratch)
        line = int(bench.rig.scratch[0] / 250) + 2  # after G91, and counted from 1
        assert bench.job_record()[:2] == ["A.NC", str(line)]
        bench.rig.link.send(b"~")
        yield bench.rig.ms(9000)  # the job ends

    assert bench.run(script)[-1] == "[MSG:Job A.NC: done, 41 lines]"
    assert bench.steps[0] == 40 * 250
    assert bench.job_record() == []


@pytest.mark.usefixtures("each_ms")
def test_reset_ends_the_job_and_reports_its_line(tmp_path: Path) -> None:
    """A reset in motion is ALARM:3. It stores and reports the line in which it stopped."""
    bench = Bench(tmp_path)
    bench.put("A.NC", *LONG)

    def script(bench: Bench) -> Iterator[Any]:
        """Reset (0x18) in the middle of the job, and unlock."""
        yield from bench.sender.wait("ok", "$F=A.NC\n")
        yield bench.rig.ms(1650)  # in a line in the middle
        yield from bench.sender.wait("banner", "\x18")
        yield bench.rig.ms(3000)  # all messages have arrived
        yield from bench.sender.wait("ok", "$X\n")

    output = bench.run(script)
    assert "ALARM:3" in output
    assert output[-1] == "ok" and output.count("ok") == 2  # of $F and $X
    line = bench.steps[0] // 250 + 2  # 250 steps/mm; after G91, and counted from 1
    assert bench.job_record()[0] == "A.NC"
    assert line - 1 <= int(bench.job_record()[1]) <= line
    assert f"[MSG:Job A.NC: stopped at line {bench.job_record()[1]}]" in output


def test_reset_in_a_dwell_is_no_alarm_and_the_line_is_stored(tmp_path: Path) -> None:
    """A dwell (line 2) has no motion, so its position is not lost by a reset."""
    bench = Bench(tmp_path)
    bench.put("A.NC", "G0X1", "G4P9", "G0X2")

    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.sender.wait("ok", "$F=A.NC\n")
        yield bench.rig.ms(4000)  # in the dwell of 9 s
        yield from bench.sender.wait("banner", "\x18")
        yield bench.rig.ms(100)

    output = bench.run(script)
    assert not [line for line in output if line.startswith("ALARM")]
    assert output[-1] == "[MSG:Job A.NC: stopped at line 2]" and bench.job_record()[1] == "2"


def test_power_cut_is_reported_at_the_next_start(tmp_path: Path) -> None:
    """The end of run() cuts the power. Only the start of a job is recorded while it runs."""
    bench = Bench(tmp_path)
    bench.put("A.NC", *LONG)
    bench.run(say("$F=A.NC", wait_s=1))
    assert bench.job_record()[:2] == ["A.NC", "1"]
    output = Bench(tmp_path, bench.store).run(say("$G", wait_s=0))
    assert output[0] == "[MSG:Job A.NC: did not finish; last recorded line: 1]"


def test_start_button_runs_its_job_only_while_idle(tmp_path: Path) -> None:
    """$FB= selects the job of the start button; without one, it does nothing.

    The second press, during the job, starts nothing.
    """
    bench = Bench(tmp_path)
    bench.put("A.NC", "G91", "G0X5")

    def press(bench: Bench) -> Iterator[Any]:
        for _ in range(2):
            bench.press()
            yield bench.rig.ms(100)
        yield bench.rig.ms(5000)  # a job ends in this time

    assert bench.run(press) == []
    output = bench.run(say("$FB", "$FB=A.NC", "$FB", wait_s=0))
    assert output == [
        "[MSG:Start button: no job]",
        *("ok", "ok"),
        "[MSG:Start button: A.NC]",
        "ok",
    ]
    assert bench.run(press)[-1] == "[MSG:Job A.NC: done, 2 lines]"
    assert len(bench.moves) == 1  # G0X5 once
    assert bench.run(say("$FB=", "$FB", wait_s=0))[1] == "[MSG:Start button: no job]"


# Files sent over the line


def push(name: str, data: bytes, checksum: "int | None" = None, cut: int = -1) -> Script:
    """Send a file as `ugrbl job push` does; cut: power fails after this number of bytes."""

    def script(bench: Bench) -> Iterator[Any]:
        """Announce name, size and checksum; send each piece after its request."""
        sender = bench.sender
        crc = zlib.crc32(data) if checksum is None else checksum
        bench.rig.link.send(f"$FU={name},{len(data)},{crc:x}\n".encode())
        for offset in range(0, len(data), _PIECE):
            request = f"[FU:{offset}]"  # the board requests each piece by its offset
            yield from sender.until(
                lambda request=request: request in sender.lines or sender.answers
            )
            piece = b"".join(jobs._lines(data[offset : offset + _PIECE])) + b"\n"
            if 0 <= cut - offset < _PIECE:
                bench.rig.link.send(piece[: cut - offset])
                yield bench.rig.ms(100)
                return
            bench.rig.link.send(piece)
        yield from sender.until(lambda: sender.answers > 0)
        yield bench.rig.ms(100)  # messages after the answer arrive

    return script


DATA = random.Random(1).randbytes(5000) + b"G0X1\n" * 25
PART = b"G0X1\n"


def test_file_is_received_byte_by_byte(tmp_path: Path) -> None:
    """Any bytes, real-time characters among them, arrive unchanged; the name in capitals."""
    bench = Bench(tmp_path)
    output = bench.run(push("new.nc", DATA))
    assert output == ["[FU:0]", "[FU:2048]", "[FU:4096]", "ok"]
    assert [file.name for file in bench.folder.iterdir()] == ["NEW.NC"]
    assert (bench.folder / "NEW.NC").read_bytes() == DATA


@pytest.mark.parametrize("cut", [0, 1, 100, 2047, 2048, 4096, 5000])
def test_power_cut_leaves_the_old_file(tmp_path: Path, cut: int) -> None:
    """An upload that is cut leaves the old file, and a next upload succeeds."""
    bench = Bench(tmp_path)
    bench.put("NEW.NC", "G0X9")
    bench.run(push("NEW.NC", DATA, cut=cut))
    restarted = Bench(tmp_path)
    files = restarted.run(say("$F", wait_s=0))
    assert files[0] == "[FILE:/NEW.NC|SIZE:5]" and files[1].startswith("[MSG:Free space: ")
    assert restarted.run(push("NEW.NC", DATA))[-1] == "ok"
    # No temporary file is left.
    assert [file.name for file in bench.folder.iterdir()] == ["NEW.NC"]


def test_wrong_checksum_leaves_the_old_file(tmp_path: Path) -> None:
    """The checksum 1 is not that of DATA."""
    bench = Bench(tmp_path)
    bench.put("NEW.NC", "G0X9")
    output = bench.run(push("NEW.NC", DATA, checksum=1))
    assert output[-2:] == ["[MSG:Upload refused: the checksum does not match]", "error:3"]
    assert [file.read_text() for file in bench.folder.iterdir()] == ["G0X9\n"]


def test_transfer_ends_when_the_sender_is_silent(tmp_path: Path) -> None:
    """5000 bytes are announced, and none is sent. The first wait() ends with the error."""
    bench = Bench(tmp_path)

    def script(bench: Bench) -> Iterator[Any]:
        yield from bench.sender.wait("ok", "$FU=A.NC,5000,0\n")
        yield from bench.sender.wait("ok", "$G\n")  # accepted again

    output = bench.run(script)
    assert output[1:3] == ["[MSG:Upload refused: the sender stopped sending]", "error:3"]
    assert list(bench.folder.iterdir()) == []


def test_reset_ends_the_transfer(tmp_path: Path) -> None:
    """The data is never sent. Real-time bytes act during a transfer: ? is answered."""
    bench = Bench(tmp_path)

    def script(bench: Bench) -> Iterator[Any]:
        """Announce a file, ask for a report, reset, and send a line."""
        bench.rig.link.send(b"$FU=A.NC,5000,0\n")
        yield bench.rig.ms(500)  # in the transfer
        bench.rig.link.send(b"?")
        yield bench.rig.ms(500)  # the report arrives
        yield from bench.sender.wait("banner", "\x18")
        yield from bench.sender.wait("ok", "$G\n")

    output = bench.run(script)
    assert output[0] == "[FU:0]" and output[1].startswith("<Idle|")
    assert list(bench.folder.iterdir()) == []


@pytest.mark.parametrize(("laser", "byte"), [(0, b"\x84"), (1, b"\x84"), (1, b"!")])
def test_door_or_hold_in_a_transfer_switches_the_tool_off_at_once(
    tmp_path: Path, laser: int, byte: bytes
) -> None:
    """`~` after the transfer switches it on again. A hold leaves a spindle on, as in Grbl."""
    bench = Bench(tmp_path)
    port = bench.rig.port

    def script(bench: Bench) -> Iterator[Any]:
        """Announce a file, send the byte; then send the file, and resume."""
        yield from say(f"$32={laser}", "G1X0.1F600", "M3S800M8", wait_s=0.5)(bench)
        assert port.spindle_pwm and port.flood
        before = port.spindle_pwm, port.flood
        bench.rig.link.send(f"$FU=A.NC,{len(PART)},{zlib.crc32(PART):x}\n".encode())
        yield bench.rig.ms(300)  # in the transfer
        bench.rig.link.send(byte)
        yield bench.rig.ms(50)
        assert port.spindle_pwm == 0 and bool(port.flood) == (byte == b"!")
        bench.rig.link.send(b"".join(jobs._lines(PART)) + b"\n")
        yield bench.rig.ms(500)  # the transfer has ended; the machine is still held
        assert port.spindle_pwm == 0
        bench.rig.link.send(b"~")
        yield bench.rig.ms(5500)  # also restores the spindle
        assert (port.spindle_pwm, port.flood) == before
        yield from say("G1X1", wait_s=2)(bench)

    assert bench.run(script)[-1] == "ok"
    assert (bench.folder / "A.NC").read_bytes() == PART
    assert bench.steps == [250, 0, 0]


def test_transfer_writes_nothing_while_the_door_parks_the_tool(tmp_path: Path) -> None:
    """The simulator raises an exception if something is stored in motion."""
    store = factory_store(load_board("sim"))
    store.files["settings"] += ["$22=1"]  # parking needs homing
    bench = Bench(tmp_path, store, PARKING=True)

    def script(bench: Bench) -> Iterator[Any]:
        """Announce a file, open the door, and send the file while the tool is moved up."""
        yield from say("$X", "G91G1Z-30F3000", "M3S800", wait_s=6)(bench)
        bench.rig.link.send(f"$FU=A.NC,{len(PART)},{zlib.crc32(PART):x}\n".encode())
        yield bench.rig.ms(300)
        bench.rig.link.send(b"\x84")
        yield bench.rig.ms(300)
        assert bench.rig.controller.state.system_motion
        bench.rig.link.send(b"".join(jobs._lines(PART)) + b"\n")
        yield bench.rig.ms(8000)  # parked
        bench.rig.link.send(b"~")
        yield bench.rig.ms(12_000)

    bench.run(script)
    assert (bench.folder / "A.NC").read_bytes() == PART


@pytest.mark.parametrize(
    ("order", "why"),
    [
        ("A.NC,0,0", "[MSG:A.NC has 0 bytes, but only "),
        ("A.NC,-5,0", "[MSG:A.NC has -5 bytes, but only "),
        ("A.NC,999999999999999,0", "[MSG:A.NC has 999999999999999 bytes, but only "),
        (".A,5,0", "[MSG:A job name may have"),
        ("A@3,5,0", "[MSG:A job name may have"),
        ("ABCDEFGHIJKLMNOPQRSTUVWXYZ1234567,5,0", "[MSG:A job name may have"),
    ],
)
def test_impossible_transfer_is_refused_first(tmp_path: Path, order: str, why: str) -> None:
    """The order is name, size and checksum. It is refused before anything is written."""
    bench = Bench(tmp_path)
    output = bench.run(say(f"$FU={order}", wait_s=0))
    assert output[0].startswith(why) and output[1:] == ["error:3"]
    assert not bench.folder.exists()


@pytest.mark.parametrize("order", ["", "A.NC", "A.NC,5", "A.NC,5,X", "A.NC,X,5"])
def test_transfer_without_its_numbers_is_refused(tmp_path: Path, order: str) -> None:
    assert Bench(tmp_path).run(say(f"$FU={order}", wait_s=0)) == ["error:2"]


# Entry in the middle of a job

FAST = ("$110=6000", "$111=6000", "$112=6000", "$120=2000", "$121=2000", "$122=2000")
HOMED = ("$22=1", "$24=300", "$25=3000", "$27=5", "$130=40", "$131=40", "$132=40", "$H")


def with_switches(bench: Bench) -> Bench:
    """Add limit switches at both ends of each axis, so that $H succeeds; return the bench."""
    listen = bench.rig.on_built

    def on_built() -> None:
        """Add the switches when the machine is built."""
        if listen:
            listen()
        # on_built is called at each restart of the firmware.
        if not bench.rig.engine.switches:
            switches.fit(bench.rig)

    bench.rig.on_built = on_built
    return bench


@pytest.mark.parametrize("dialect", ["1.1", "0.9"])
@pytest.mark.parametrize("startup", ["G54", "G99"])
def test_startup_lines_after_homing_are_no_lines_of_the_job(
    tmp_path: Path, dialect: str, startup: str
) -> None:
    """$H runs the startup line; G99 is refused, which does not end the job. Line 5 is refused."""
    bench = with_switches(Bench(tmp_path, DIALECT=dialect))
    bench.put("A.NC", "G4P0.01", "$H", "G4P0.01", "G4P0.01", "G999", "G4P0.01")
    output = bench.run(say(*HOMED, f"$N0={startup}", "$F=A.NC", wait_s=60))
    refusals = [line for line in output if "is refused" in line]
    assert len(refusals) == 1 and "Job A.NC: line 5 is refused with 20" in refusals[0]


def test_job_entry_needs_a_homed_machine(tmp_path: Path) -> None:
    """@3: at line 3."""
    bench = Bench(tmp_path)
    bench.put("A.NC", *PROGRAM)
    output = bench.run(say("$F=A.NC@3", wait_s=1))
    why = "to start at a line within the job, home first ($H)"
    assert output == [f"[MSG:Job A.NC: {why}]", "error:3"]
    assert bench.moves == []


ROUTER = (
    "G21 G90 G54",
    "G0 X0 Y0 Z-10",
    "M3 S1000",
    "G0 X-100 Y-50",
    "G1 Z-30 F600",
    "G91 G1 X-20",
    "Y-20",
    "X20",
    "G90 G2 X-100 Y-50 I0 J10",
    "G0 Z-10",
    "M30",
)


@pytest.mark.sampled(1, 3)
@pytest.mark.parametrize("line", range(2, 12))
def test_job_continues_at_a_line_as_if_all_before_it_had_been_executed(
    tmp_path: Path, line: int
) -> None:
    """ROUTER has lines, an arc and modes.

    Entered at any line, it has the moves and the end of a whole run.
    """
    whole = with_switches(Bench(tmp_path))
    whole.put("A.NC", *ROUTER)
    whole.run(until_job_ends(*FAST, *HOMED, "$F=A.NC"))
    part = with_switches(Bench(tmp_path))
    output = part.run(until_job_ends(*FAST, *HOMED, f"$F=A.NC@{line}"))
    assert f"[MSG:Job A.NC: continues at line {line}]" in output
    assert output[-1] == "[MSG:Job A.NC: done, 11 lines]"
    assert part.steps == whole.steps
    assert part.moves_from(line) == whole.moves_from(line)


# Faults found by trials


def test_job_of_dialect_0_9_continues_at_the_line_after_a_comma(tmp_path: Path) -> None:
    """@ opens the safety door there: PART@3 would then start PART3."""
    bench = with_switches(Bench(tmp_path, DIALECT="0.9"))
    bench.put("PART.NC", "G21G90", "G1X-6F3000", "G1X-7", "G1X-8")
    output = bench.run(say(*FAST, *HOMED, "$F=PART.NC,4"))
    assert output[-1] == "[Job PART.NC: done, 4 lines]"
    assert bench.moves[-1][0] == -8 and -6 not in [target[0] for target in bench.moves]


def test_job_can_be_entered_after_words_that_only_lenient_accepts(tmp_path: Path) -> None:
    """Lines 1, 2 and 4 are ignored by a lenient machine, and must not stop the entry at line 7."""
    bench = Bench(tmp_path, LENIENT=True)
    bench.put("A.NC", "%", "O1", "G21G90", "G43H1", "G0X1", "G1X2F500", "G1X3")
    output = with_switches(bench).run(say(*FAST, *HOMED, "$F=A.NC@7", wait_s=10))
    assert output[-1] == "[MSG:Job A.NC: done, 7 lines]", output[-3:]
    assert bench.moves[-1][0] == 3


def test_start_button_starts_the_job_from_its_beginning(tmp_path: Path) -> None:
    """A press in a hold only ends the hold, and one in a dwell does nothing.

    The third starts the job, and executes all its lines.
    """
    bench = Bench(tmp_path)
    bench.put("A.NC", "G91", "G0X5", "G0Y5")

    def script(bench: Bench) -> Iterator[Any]:
        """Press the button in a hold, in a dwell, and while idle."""
        yield from say("$FB=A.NC", wait_s=0)(bench)
        machine = bench.rig.controller
        bench.rig.link.send(b"!")
        yield bench.rig.ms(300)  # the hold is complete
        assert machine.state.run == HOLD
        bench.press()  # only ends the hold
        yield bench.rig.ms(3000)  # a job would have begun
        assert bench.moves == []
        bench.rig.link.send(b"G4P0.5\n")  # a dwell: the machine is not idle
        yield bench.rig.ms(200)  # in the dwell
        bench.press()
        yield bench.rig.ms(3000)  # the dwell and a job would have ended
        assert bench.moves == []
        bench.press()
        yield bench.rig.ms(3000)  # the job ends

    assert bench.run(script)[-1] == "[MSG:Job A.NC: done, 3 lines]"
    assert bench.moves == [(5, 0, 0), (5, 5, 0)]


def test_hold_is_noted_when_tool_is_parked_not_while_it_moves(tmp_path: Path) -> None:
    """A door opens in line 2. The line is stored after the parking motion, not during it."""
    store = factory_store(load_board("sim"))
    store.files["settings"] += ["$22=1"]
    bench = Bench(tmp_path, store, PARKING=True)
    bench.put("DOOR.NC", "G21G91G0Z-10", "G1X20F300")

    def script(bench: Bench) -> Iterator[Any]:
        """Open the door in line 2, which is stored after the parking motion."""
        yield from say("$X", "$F=DOOR.NC", wait_s=4)(bench)  # in line 2
        bench.rig.link.send(b"\x84")  # door: the tool is parked
        yield lambda: bench.rig.controller.state.system_motion
        while bench.rig.controller.state.system_motion:
            assert bench.job_record()[1] == "1"  # stored when it began
            yield bench.rig.ms(5)
        yield bench.rig.ms(200)  # the line is stored
        assert bench.job_record()[1] == "2" and not bench.rig.moving()
        bench.rig.link.send(b"~")
        yield bench.rig.ms(15_000)  # the job ends

    assert bench.run(script)[-1] == "[MSG:Job DOOR.NC: done, 2 lines]"
    # 20 mm and -10 mm at 250 steps/mm.
    assert bench.steps == [5000, 0, -2500] and bench.job_record() == []


@pytest.mark.parametrize("byte", [b"!", b"\x84"])
def test_hold_while_the_entry_is_computed_keeps_the_tool_in_place(
    tmp_path: Path, byte: bytes
) -> None:
    """3000 dwells before the entry take the board a while to read.

    A hold or door in that time ends the start.
    """
    bench = with_switches(Bench(tmp_path))
    bench.put("A.NC", "G21", "M3S800", *["G4P0"] * 3000, "G0X-9")

    def script(bench: Bench) -> Iterator[Any]:
        """Start at line 3000, and send the byte (hold or door) 20 ms later."""
        yield from say(*FAST, *HOMED, wait_s=0)(bench)
        bench.moves.clear()
        bench.rig.link.send(b"$F=A.NC@3000\n")
        yield bench.rig.ms(20)  # the lines before the entry are being read
        bench.rig.link.send(byte)
        yield bench.rig.ms(20_000)  # longer than reading them takes

    output = bench.run(script)
    assert "[MSG:Job A.NC: the start was interrupted by a hold, door or sleep]" in output
    assert bench.moves == [] and bench.rig.port.spindle_pwm == 0


def test_job_continues_with_the_modes_in_force_at_its_start(tmp_path: Path) -> None:
    """The user sets G55 and a tool length before the job.

    After a reset neither is active, but an entry at the stored line has them again.
    """
    bench = with_switches(Bench(tmp_path))
    bench.put("A.NC", "G0X1", "G1Y1F6000", "G0X2", *["G1X9F60", "G1X8"] * 9)

    def script(bench: Bench) -> Iterator[Any]:
        """Set G55, start the job, reset in line 4, home, and resume at that line."""
        setup = ("G10L2P2X-9Y-9Z-9", "G55", "G43.1Z3", "$F=A.NC")
        yield from say(*FAST, *HOMED, *setup, wait_s=4)(bench)  # in line 4, which is slow
        bench.rig.link.send(b"!")
        yield bench.rig.ms(2000)  # until it has stopped
        yield from bench.sender.wait("banner", "\x18")
        bench.moves.clear()
        yield from say("$H", "$F=@", wait_s=20)(bench)
        assert bench.job_record()[1] == "4"
        assert bench.moves[0][0] == -5  # up, from the switch
        assert bench.moves[1] == (-7, -8, -5)  # across to X2 Y1 of G55
        assert bench.moves[-1][0] in (0, -1)  # X9 or X8 of G55, which has X-9

    output = bench.run(script)
    assert any("continues at line" in text for text in output), output


@pytest.mark.parametrize("line", ["$H", "$J=G91X1F100", "$C", "$SLP"])
def test_entry_after_commands_of_unknown_effect_is_refused(tmp_path: Path, line: str) -> None:
    bench = with_switches(Bench(tmp_path))
    bench.put("A.NC", "G21", line, "G0X-9")
    output = bench.run(until_job_ends(*FAST, *HOMED, "$F=A.NC@3"))
    assert output[-1] == "[MSG:Job A.NC: line 2 is a $ command of unknown effect: start before it]"


def test_client_that_opens_the_port_in_a_dwell_is_welcomed_and_the_job_continues(
    tmp_path: Path,
) -> None:
    """The welcome must not reset anything."""
    bench = Bench(tmp_path)
    bench.put("A.NC", "M3S700", "G4P2", "G0X1", "M5")

    greeting: list[bytes] = []

    def script(bench: Bench) -> Iterator[Any]:
        """Start the job, and send a welcome to a new client in its dwell."""
        yield from say("$F=A.NC", wait_s=1)(bench)
        # As the firmware does for a network client that connects: only it gets the welcome.
        report = bench.rig.controller.report
        link, report._link = report._link, SimpleNamespace(write=greeting.append)
        bench.rig.controller.welcome()
        report._link = link
        yield bench.rig.ms(5000)  # the job ends

    assert bench.run(script)[-1] == "[MSG:Job A.NC: done, 4 lines]"
    assert b"Grbl 1.1h" in bytes(greeting[0])


def test_refused_entry_restores_modes_and_offsets_and_leaves_the_tool_off(
    tmp_path: Path,
) -> None:
    """Reading the lines before the entry changes modes and offsets, until G5 (line 4) is refused.

    All are as before the start then, but the tool is off.
    """
    bench = with_switches(Bench(tmp_path))
    bench.put("A.NC", "G20G91G92X1", "G43.1Z2", "G54", "G5")
    # Set by the user; $G and $# report modes and offsets.
    modes = ("G55", "M3S500", "F77", "$G", "$#")
    output = bench.run(say(*FAST, *HOMED, *modes, "$F=A.NC@9", "$G", "$#", wait_s=5))
    before, after = [text for text in output if text.startswith("[GC:")]
    assert after == before.replace("M3", "M5")
    for name in ("[G92:", "[TLO:"):
        first, second = [text for text in output if text.startswith(name)]
        assert first == second
    assert bench.rig.port.spindle_pwm == 0


def test_failed_probe_in_a_job_switches_the_tool_off(tmp_path: Path) -> None:
    """The probe never closes: the machine stops in alarm, without the last line."""
    bench = Bench(tmp_path)
    bench.put("A.NC", "M3S900", "G91G38.2Z-1F600", "G0X1")
    output = bench.run(say("$F=A.NC"))
    assert "ALARM:5" in output
    assert bench.rig.port.spindle_pwm == 0 and bench.steps[0] == 0


def test_check_mode_keeps_the_stored_record(tmp_path: Path) -> None:
    """A job that a power cut (the end of run()) has stopped stays recorded."""
    bench = Bench(tmp_path)
    bench.put("A.NC", *LONG)
    bench.run(say("$F=A.NC", wait_s=1))
    record = bench.job_record()
    Bench(tmp_path, bench.store).run(say("$C", "$F=A.NC"))
    assert bench.job_record() == record


def test_job_is_not_resumed_with_another_file_of_that_name(tmp_path: Path) -> None:
    """The end of the first run() cuts the power during the job."""
    bench = with_switches(Bench(tmp_path))
    bench.put("A.NC", *LONG)
    bench.run(say("$F=A.NC", wait_s=1))
    bench.put("A.NC", "G0X1", "G0X2")
    restarted = with_switches(Bench(tmp_path, bench.store))
    output = restarted.run(say(*FAST, *HOMED, "$F=@", wait_s=5))
    assert output[-1] == "[MSG:Job A.NC: the file has changed since that job stopped]"


def test_job_does_not_start_jobs(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.put("A.NC", "G0X1", "$F=A.NC")
    assert bench.run(say("$F=A.NC"))[-1] == "[MSG:Job A.NC: line 2 is refused with 8]"


def test_status_requests_do_not_keep_a_transfer_open(
    tmp_path: Path,
) -> None:
    """The data is no valid piece. Status requests follow for 6 s: the upload still ends."""
    bench = Bench(tmp_path)

    def script(bench: Bench) -> Iterator[Any]:
        bench.rig.link.send(b"$FU=A.NC,5000,0\nzzzz*\n\n")
        for _ in range(60):  # of 100 ms each
            bench.rig.link.send(b"?")
            yield bench.rig.ms(100)

    output = bench.run(script)
    assert "[MSG:Upload refused: the data arrived damaged]" in output and "error:3" in output
    reports = [text for text in output if text.startswith("<")]
    assert len(reports) > 50
