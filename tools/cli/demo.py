"""`ugrbl demo`: an example program, sent to the simulator and drawn."""

import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console

from .. import paths
from ..device.connection import Connection, SendError
from ..device.send import Ready, Report, Stream
from ..grbl.gcode_file import read_lines
from ..grbl.messages import meaning
from ..run.recorder import Totals
from .screen import Screen, show_errors, summary, totals_rows

_PROGRAM = "badge.nc"
_PICTURE = Path("build/badge.png")
# A light router: the factory settings of Grbl are very slow.
_SETTINGS = (
    "$110=6000",  # mm/min
    "$111=6000",
    "$112=3000",
    "$120=500",  # mm/s2
    "$121=500",
    "$122=300",
)
_PATIENCE_S = 20.0


class Simulator:
    """`ugrbl sim` in a process of its own, at full speed."""

    def __init__(self, folder: Path, picture: Path) -> None:
        self.port = folder / "grbl"
        self._report = folder / "report.json"
        command = [sys.executable, "-m", f"{__package__}", "sim", "--speed", "max"]  # ugrbl.cli
        command += ["--port", str(self.port), "--report", str(self._report)]
        command += ["--plot", str(picture)]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL)

    def wait_until_there(self) -> None:
        """Wait until the port can be opened."""
        until = time.monotonic() + _PATIENCE_S
        while not self.port.is_symlink():
            if self._process.poll() is not None or time.monotonic() > until:
                raise SendError("the simulator did not start")
            time.sleep(0.02)

    def finish(self) -> Totals:
        """End the simulator; it writes its report and its picture. Returns the totals."""
        self._process.send_signal(signal.SIGTERM)
        if self._process.wait() != 0:
            raise SendError("the simulator failed")
        return Totals.load(self._report)

    def kill(self) -> None:
        """End the process in any case."""
        self._process.kill()
        self._process.wait()


@contextmanager
def simulator(picture: Path) -> Iterator[Simulator]:
    """Yield a running simulator."""
    with tempfile.TemporaryDirectory() as folder:
        running = Simulator(Path(folder), picture)
        try:
            running.wait_until_there()
            yield running
        finally:
            running.kill()


def demo(console: Console) -> bool:
    """Stream the example and show the result. Returns whether everything was right."""
    lines = read_lines(paths.EXAMPLES / _PROGRAM)
    with simulator(_PICTURE) as running:
        report, seconds = _stream(running, lines, console)
        console.print("Drawing …")
        totals = running.finish()
    show_errors(console, report.errors, lines)
    console.print(_summary(report, totals, seconds))
    made_all = totals.steps_planned == totals.steps_made and any(totals.steps_made.values())
    sent_all = report.answered == len(lines)
    return report.ok() and sent_all and report.state == "Idle" and made_all


def _stream(running: Simulator, lines: Sequence[bytes], console: Console) -> tuple[Report, float]:
    """Send the settings and the program; returns the result, and the seconds that it took."""
    connection = Connection(str(running.port))
    try:
        connection.start()
        for setting in _SETTINGS:
            answer = connection.ask(setting)[-1]
            if answer != "ok":
                raise SendError(f"{setting}: {answer}: {meaning(answer)}")
        begun = time.monotonic()
        with Screen(console, _PROGRAM, len(lines)) as screen:
            report = Stream(connection, Ready(lines), screen, keep_going=True).run()
            screen.progress(report.answered, f"<{report.state}>")
        return report, time.monotonic() - begun
    finally:
        connection.close()


def _summary(report: Report, totals: Totals, seconds: float) -> object:
    """Return a table of the result. seconds: time of streaming."""
    return summary(
        [
            ("lines", str(report.answered)),
            ("errors", str(len(report.errors))),
            *totals_rows(totals),
            ("ended", report.stopped or report.state),
            ("streamed in", f"{seconds:.1f} s"),
            ("picture", str(_PICTURE.resolve())),
        ]
    )
