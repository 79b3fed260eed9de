"""`ugrbl web` in a separate process."""

import signal
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from as_users import as_users

PATIENCE_S = 60.0


class Web:
    """A running server. address: as printed by it."""

    def __init__(self, *words: str, **environment: str) -> None:
        command = [sys.executable, "-m", "ugrbl.cli", "web", "--http", "0", *words]
        self.process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=as_users(PYTHONUNBUFFERED="1", **environment),
            text=True,
        )
        assert self.process.stdout
        self.said = self.process.stdout.readline()
        assert " is at http://" in self.said, self.said + self.process.communicate()[0]
        self.address = self.said.rpartition(" is at ")[2].strip()

    def get(self, address: str) -> "tuple[int, str]":
        try:
            with urllib.request.urlopen(address, timeout=PATIENCE_S) as got:
                return got.status, got.read().decode()
        except urllib.error.HTTPError as error:
            return error.code, error.read().decode()

    def stop(self, number: int = signal.SIGINT) -> str:
        self.process.send_signal(number)
        return self.process.communicate(timeout=PATIENCE_S)[0]

    def children(self) -> "list[int]":
        """Return its child processes, for example the simulator."""
        files = list(Path(f"/proc/{self.process.pid}/task").glob("*/children"))
        if not files:
            pytest.skip("no /proc here that tells of children")
        return [int(number) for file in files for number in file.read_text().split()]

    def close(self) -> None:
        """Stop it in any state."""
        self.process.kill()
        self.process.communicate()
