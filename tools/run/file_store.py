"""A Store in one text file, in the format of `ugrbl settings pull`: `$n=v` lines.

Other stored values are in comments, `;[startup] G21`, so that `ugrbl settings push` can read the
file. Comments and values by others are kept as they are. A file that cannot be read, or that
another program has changed meanwhile, is never overwritten.
"""

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from .. import paths
from ..grbl.settings_file import SETTING, Firmware, Settings, SettingsError, same

_OTHER = re.compile(r";\[(\w+)\] ?(.*)")
# All names of the firmware for its settings begin so; the rest depends on the tool.
_SETTINGS = "settings"
_BEYOND = 3.5e38  # more than single precision holds, which the firmware uses


class FileStore:
    """Stores the persistent values of a machine between runs.

    factory: values if the file does not have them. firmware: whose settings they are. Raises
    SettingsError for a file that cannot be parsed, OSError for one that cannot be read.
    """

    def __init__(
        self,
        path: Path,
        factory: Mapping[str, Sequence[str]] | None = None,
        firmware: Firmware | None = None,
    ) -> None:
        self._path = Path(os.path.realpath(path))  # a link stays a link
        self._firmware = firmware or Firmware()
        self.damaged: dict[str, bool] = {}  # always empty, because a damaged file is refused
        self._text = self._read_file()  # the file as last read or written, to notice other changes
        self._stored = {name: list(lines) for name, lines in (factory or {}).items()}
        if self._text is None:
            _check_folder(self._path)
        else:
            self._stored.update(_read(_decoded(self._text), self._firmware))

    def load(self, name: str) -> list[str] | None:
        """Return the lines last saved under a name; None if there are none."""
        lines = self._stored.get(_SETTINGS if name.startswith(_SETTINGS) else name)
        return None if lines is None else list(lines)

    def save(self, name: str, lines: Iterable[str]) -> None:
        """Store lines under a name: replace the file completely, or leave it unchanged. OSError if
        it cannot be replaced."""
        key = _SETTINGS if name.startswith(_SETTINGS) else name  # settings_punch, too
        stored = {**self._stored, key: list(lines)}
        if self._read_file() != self._text:
            raise OSError(
                f"{self._path} has been changed by another program: it is not overwritten"
            )
        before = "" if self._text is None else _decoded(self._text)
        text = "".join(f"{line}\n" for line in _new_lines(before, stored, self._firmware)).encode()
        paths.write(self._path, text)
        self._stored, self._text = stored, text

    def _read_file(self) -> bytes | None:
        """Return the file's content now; None if there is no file."""
        try:
            return self._path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise OSError(f"{self._path} cannot be read: {paths.why(error)}") from error


def _decoded(data: bytes) -> str:
    """Return the data as text, without a byte order mark. SettingsError if they are no text."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SettingsError("it is no text") from error


def _read(text: str, firmware: Firmware) -> dict[str, list[str]]:
    """Return the stored lines in a file, by name. SettingsError if it is no settings file, or one
    of another firmware."""
    settings = Settings.read("\n".join(line for line in text.splitlines() if not _other(line)))
    version = settings.firmware.version
    if version and firmware.version and version != firmware.version:
        raise SettingsError(f"it is for {settings.firmware}, the machine is a {firmware}")
    stored: dict[str, list[str]] = {}
    for match in filter(None, map(_other, text.splitlines())):
        stored.setdefault(match[1], []).append(match[2])
    for number, value in settings.values.items():
        if not float(value) < _BEYOND:
            raise SettingsError(f"${number} cannot be {value}")
        stored.setdefault(_SETTINGS, []).append(f"${number}={value}")
    if text.strip() and not stored:
        raise SettingsError("it has no settings (lines of the form $n=v)")
    return stored


def _other(line: str) -> re.Match[str] | None:
    """Return the match of a line with a stored value that is not a setting."""
    return _OTHER.fullmatch(line)


def _new_lines(
    before: str, stored: Mapping[str, Sequence[str]], firmware: Firmware
) -> Iterator[str]:
    """Yield the lines of the new file: those of the old one (before: its text), with new values
    where they differ, then new settings, then all other stored lines."""
    values = Settings.read("\n".join(stored.get(_SETTINGS, ()))).values
    if before:
        yield from _updated_lines(before, values)
        yield from (f"${number}={value}" for number, value in values.items())
    else:
        yield from Settings(firmware, values).text("kept by ugrbl sim").splitlines()
    for name, lines in stored.items():
        if name != _SETTINGS:
            yield from (f";[{name}] {line}".rstrip() for line in lines)


def _updated_lines(before: str, values: dict[int, str]) -> Iterator[str]:
    """Yield the old lines with their new values, and remove these from `values`. A setting that
    has none is left out."""
    for line in before.splitlines():
        if _other(line):  # a stored value in a comment: written anew
            continue
        match = SETTING.fullmatch(line.strip())
        if match is None:  # a comment, or a line by others
            yield line
        elif (number := int(match[1])) in values:
            value, indent = values.pop(number), len(line) - len(line.lstrip())
            begin, end = (indent + index for index in match.span(2))
            yield line if same(value, match[2]) else line[:begin] + value + line[end:]


def _check_folder(path: Path) -> None:
    """Raise OSError if the file cannot be created, before a machine runs without being able to
    save."""
    if not path.parent.is_dir():
        raise FileNotFoundError(f"there is no folder {path.parent}")
    paths.check_writable(path)
