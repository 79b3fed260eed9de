"""A Store in one text file, of the form that `ugrbl settings pull` writes: `$n=v` lines.

What a machine keeps besides stands in comments, `;[startup] G21`, so that the file stays one for
`ugrbl settings push`. Comments and values that others wrote are kept as they are. A file that is
not understood, or that somebody else has changed meanwhile, is never written over.
"""

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from .. import paths
from ..grbl.settings_file import SETTING, Firmware, Settings, SettingsError, same

_OTHER = re.compile(r";\[(\w+)\] ?(.*)")
# The firmware's names of its settings; which it uses hangs on its tool.
_SETTINGS = "settings"
_BEYOND = 3.5e38  # single precision, as the firmware's


class FileStore:
    """Keeps what a machine keeps between runs.

    factory: what holds where the file says nothing. firmware: whose settings they are. Raises
    SettingsError for a file that is not understood, OSError for one that cannot be read.
    """

    def __init__(
        self,
        path: Path,
        factory: Mapping[str, Sequence[str]] | None = None,
        firmware: Firmware | None = None,
    ) -> None:
        self._path = Path(os.path.realpath(path))  # a link stays one
        self._firmware = firmware or Firmware()
        self.damaged: dict[str, bool] = {}  # a damaged file is refused
        self._text = self._there()
        self._kept = {name: list(lines) for name, lines in (factory or {}).items()}
        if self._text is None:
            _check_folder(self._path)
        else:
            self._kept.update(_read(_decoded(self._text), self._firmware))

    def load(self, name: str) -> list[str] | None:
        """What was last saved under name."""
        lines = self._kept.get(_SETTINGS if name.startswith(_SETTINGS) else name)
        return None if lines is None else list(lines)

    def save(self, name: str, lines: Iterable[str]) -> None:
        """Replace the file by a new one, or leave it as it was. OSError where that has to be."""
        kept = {**self._kept, _SETTINGS if name.startswith(_SETTINGS) else name: list(lines)}
        if self._there() != self._text:
            raise OSError(f"{self._path} has been changed by somebody else: it is left alone")
        before = "" if self._text is None else _decoded(self._text)
        text = "".join(f"{line}\n" for line in _written(before, kept, self._firmware)).encode()
        paths.write(self._path, text)
        self._kept, self._text = kept, text

    def _there(self) -> bytes | None:
        try:
            return self._path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise OSError(f"{self._path} cannot be read: {paths.why(error)}") from error


def _decoded(data: bytes) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SettingsError("it is no text") from error


def _read(text: str, firmware: Firmware) -> dict[str, list[str]]:
    """What is kept in a file, by name."""
    settings = Settings.read("\n".join(line for line in text.splitlines() if not _other(line)))
    theirs = settings.firmware.version
    if theirs and firmware.version and theirs != firmware.version:
        raise SettingsError(f"it is for {settings.firmware}, the machine is a {firmware}")
    kept: dict[str, list[str]] = {}
    for match in filter(None, map(_other, text.splitlines())):
        kept.setdefault(match[1], []).append(match[2])
    for number, value in settings.values.items():
        if not float(value) < _BEYOND:
            raise SettingsError(f"${number} cannot be {value}")
        kept.setdefault(_SETTINGS, []).append(f"${number}={value}")
    if text.strip() and not kept:
        raise SettingsError("it holds no settings, lines of $n=v")
    return kept


def _other(line: str) -> re.Match[str] | None:
    """What is kept besides settings."""
    return _OTHER.fullmatch(line)


def _written(before: str, kept: Mapping[str, Sequence[str]], firmware: Firmware) -> Iterator[str]:
    """The lines of the new file: those of the old one, with new values where they differ."""
    values = Settings.read("\n".join(kept.get(_SETTINGS, ()))).values
    if before:
        yield from _renewed(before, values)
        yield from (f"${number}={value}" for number, value in values.items())
    else:
        yield from Settings(firmware, values).text("kept by ugrbl sim").splitlines()
    for name, lines in kept.items():
        if name != _SETTINGS:
            yield from (f";[{name}] {line}".rstrip() for line in lines)


def _renewed(before: str, values: dict[int, str]) -> Iterator[str]:
    """The old lines with their new values, which are taken out of values."""
    for line in before.splitlines():
        if _other(line):
            continue
        match = SETTING.fullmatch(line.strip())
        if match is None:
            yield line
        elif (number := int(match[1])) in values:
            value, indent = values.pop(number), len(line) - len(line.lstrip())
            begin, end = (indent + place for place in match.span(2))
            yield line if same(value, match[2]) else line[:begin] + value + line[end:]


def _check_folder(path: Path) -> None:
    """OSError where no file can come to be: told before a machine has run in vain."""
    if not path.parent.is_dir():
        raise FileNotFoundError(f"there is no folder {path.parent}")
    paths.check_writable(path)
