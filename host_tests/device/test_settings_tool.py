"""Test `ugrbl settings` at a simulator on a pseudo-terminal.

pull writes the machine's settings into a file, diff compares them, push sends those that differ,
and saves the old values in FILE.before, which restore sends back. One simulator
serves all tests of this module."""

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from sim_bench import Bench
from typer.testing import CliRunner, Result
from ugrbl.cli.app import app
from ugrbl.device import settings_sync
from ugrbl.device.connection import Connection, SendError
from ugrbl.grbl import settings_file
from ugrbl.grbl.settings_file import (
    Change,
    Firmware,
    Settings,
    SettingsError,
    changes,
    check_fit,
    meaning,
    read_settings,
)

GRBL = ["[VER:1.1h.20190830:]", "[OPT:V,15,128]"]


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """Return a running simulator with factory settings."""
    running = Bench(tmp_path_factory.mktemp("sim"), "--speed", "max")
    yield running
    running.kill()


def ugrbl(bench: Bench, *words: object, answer: str = "") -> Result:
    """Run `ugrbl settings` at this machine; answer: what the user types."""
    command = ["settings", *map(str, words), "--port", str(bench.port)]
    return CliRunner().invoke(app, command, input=answer)


@pytest.fixture
def pulled(bench: Bench, tmp_path: Path) -> Path:
    """Pull a file from a machine with factory settings."""
    file = tmp_path / "router.settings"
    done = ugrbl(bench, "pull", file)
    assert done.exit_code == 0, done.output
    return file


def edit(file: Path, **values: str) -> None:
    """Change settings in a file; s110="6000" is $110=6000."""
    lines = file.read_text().splitlines()
    for name, value in values.items():
        start = f"${name[1:]}="
        lines = [start + value if line.startswith(start) else line for line in lines]
    file.write_text("\n".join(lines) + "\n")


# Pull


def test_pulled_file_explains_each_setting(pulled: Path) -> None:
    text = pulled.read_text()
    lines = [line for line in text.splitlines() if line.startswith("$")]
    assert len(lines) == 34
    assert "; [VER:1.1h." in text and "; [OPT:V,15,128]" in text
    line = next(line for line in lines if line.startswith("$121="))
    assert line.startswith("$121=10.000") and "; Acceleration Y, mm/sec^2" in line
    assert all("; " in line for line in lines)


def test_pulled_file_can_be_streamed_by_any_sender(bench: Bench, pulled: Path) -> None:
    """It has no characters that would act as real-time commands."""
    done = CliRunner().invoke(
        app, ["send", str(pulled), "--port", str(bench.port), "--mode", "line"]
    )
    assert done.exit_code == 0, done.output
    assert not set(pulled.read_text()) & set("?!~") and pulled.read_text().isascii()


def test_pulled_file_is_read_back_unchanged(pulled: Path) -> None:
    settings = Settings.read(pulled.read_text())
    assert Settings.read(settings.text()) == settings
    assert settings.firmware.version == "1.1" and settings.firmware.options == "V,15,128"


def test_existing_file_is_not_overwritten_without_force(bench: Bench, pulled: Path) -> None:
    done = ugrbl(bench, "pull", pulled)
    assert done.exit_code == 1 and "--force" in done.output
    assert ugrbl(bench, "pull", pulled, "--force").exit_code == 0


_CASES = Path(__file__).parents[3] / "shared" / "cases"


@pytest.mark.parametrize("file", sorted(_CASES.glob("L_settings_*")), ids=lambda file: file.stem)
def test_files_of_other_programs_are_read(file: Path) -> None:
    """Files of senders, consoles and editors."""
    assert read_settings(file).values[100] in ("80.000", "80.00000")


@pytest.mark.parametrize("line", ["error:20", "$N0=G54", "hello", "$100"])
def test_line_that_is_neither_setting_nor_comment_is_named(tmp_path: Path, line: str) -> None:
    file = tmp_path / "mine.settings"
    file.write_text(f"$100=80\n{line}\n")
    with pytest.raises(SettingsError, match="line 2 is no setting"):
        read_settings(file)


# Compare


def test_equal_settings_exit_with_0(bench: Bench, pulled: Path) -> None:
    done = ugrbl(bench, "diff", pulled)
    assert done.exit_code == 0 and "nothing would change" in done.output


def test_difference_is_shown_with_name_and_unit(bench: Bench, pulled: Path) -> None:
    edit(pulled, s110="6000", s11="0.01")  # the second is the same number
    done = ugrbl(bench, "diff", pulled)
    assert done.exit_code == 1
    assert "$110" in done.output and "Maximum rate X" in done.output and "mm/min" in done.output
    assert "$11 " not in done.output


def test_difference_is_printed_as_json(bench: Bench, pulled: Path) -> None:
    edit(pulled, s110="6000")
    done = ugrbl(bench, "diff", pulled, "--json", "-")
    report = json.loads(done.stdout)
    assert report["firmware"]["version"] == "1.1"
    assert report["changes"] == [
        {
            "number": 110,
            "before": "500.000",
            "after": "6000",
            "name": "Maximum rate X",
            "unit": "mm/min",
        }
    ]


# Push and restore


def test_push_shows_asks_changes_and_saves_the_old_values(bench: Bench, pulled: Path) -> None:
    """Answers no, none (no terminal), and yes; then the old values are restored."""
    edit(pulled, s120="500", s20="1", s22="1")  # $20 is refused until $22 is set
    done = ugrbl(bench, "push", pulled, answer="n\n")
    assert done.exit_code == 1 and "nothing has been changed" in done.output
    done = ugrbl(bench, "push", pulled, answer="")
    assert (
        done.exit_code == 1
        and "nothing has been changed; --yes skips this question" in done.output
    )
    done = ugrbl(bench, "push", pulled, answer="y\n")
    assert done.exit_code == 0, done.output
    assert done.output.index("Acceleration X") < done.output.index("Change 3 settings?")
    assert ugrbl(bench, "diff", pulled).exit_code == 0

    before = pulled.with_name(pulled.name + ".before")
    assert "$120=10.000" in before.read_text()
    done = ugrbl(bench, "restore", before, "--yes")
    assert done.exit_code == 0, done.output
    assert ugrbl(bench, "diff", before).exit_code == 0


def test_refused_value_is_reported_and_the_rest_is_pushed(bench: Bench, pulled: Path) -> None:
    """$0=1 is shorter than 3 us, which Grbl refuses."""
    before = pulled.with_name("before")
    before.write_text(pulled.read_text())
    edit(pulled, s0="1", s1="99")
    done = ugrbl(bench, "push", pulled, "--yes", "--json", pulled.with_name("result"))
    assert done.exit_code == 1
    assert "$0=1: error:6" in done.output
    undo_command = f"ugrbl settings restore {pulled}.before"
    assert f"1 of 2 settings changed; to undo: {undo_command}" in " ".join(done.output.split())
    result = json.loads(pulled.with_name("result").read_text())
    assert [row["number"] for row in result["refused"]] == [0]
    assert ugrbl(bench, "restore", before, "--yes").exit_code == 0


@pytest.mark.parametrize("end", [SendError("the connection broke"), KeyboardInterrupt()])
def test_interrupted_push_reports_its_progress_and_the_way_back(
    bench: Bench, pulled: Path, monkeypatch: pytest.MonkeyPatch, end: BaseException
) -> None:
    """The connection breaks, or the user presses Ctrl-C, after the first of three settings."""

    def breaks_off(
        connection: Connection, todo: Sequence[Change], progress: Callable[[Change], None]
    ) -> None:
        progress(todo[0])
        raise end

    monkeypatch.setattr(settings_sync, "push", breaks_off)
    edit(pulled, s120="500", s121="500", s122="500")
    done = ugrbl(bench, "push", pulled, "--yes")
    assert done.exit_code == (1 if isinstance(end, SendError) else 130)
    undo_command = f"ugrbl settings restore {pulled}.before"
    assert f"1 of 3 settings changed; to undo: {undo_command}" in " ".join(done.output.split())


def test_push_with_all_values_refused_offers_no_way_back(bench: Bench, pulled: Path) -> None:
    edit(pulled, s0="1")
    done = ugrbl(bench, "push", pulled, "--yes")
    assert done.exit_code == 1 and "0 of 1 setting changed" in done.output
    assert "to go back" not in done.output


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("$100=0", "0 steps/mm for X"),
        ("$111=0.0", "a highest rate of 0 for Y"),
        ("$122=0", "an acceleration of 0 for Z"),
    ],
)
def test_zero_that_stops_an_axis_is_reported_before_the_question(
    bench: Bench, tmp_path: Path, line: str, what: str
) -> None:
    file = tmp_path / "zero"
    file.write_text(f"; [VER:1.1h.20190830:]\n{line}\n")
    done = ugrbl(bench, "push", file, answer="n\n")
    output = " ".join(done.output.split())
    assert f"note: {line} means {what}: it will not move as it should" in output
    assert output.index("note: ") < output.index("Change 1 setting?")
    assert "note: " in ugrbl(bench, "diff", file).output


def test_failed_pull_leaves_no_folders(tmp_path: Path) -> None:
    file = tmp_path / "a" / "b" / "c"
    done = CliRunner().invoke(app, ["settings", "pull", str(file), "--port", "/dev/nowhere"])
    assert done.exit_code == 1 and not (tmp_path / "a").exists()


def test_pull_creates_the_folders_of_its_file(bench: Bench, tmp_path: Path) -> None:
    file = tmp_path / "a" / "b" / "c"
    assert ugrbl(bench, "pull", file).exit_code == 0 and file.exists()


def test_push_leaves_settings_not_in_the_file_unchanged(bench: Bench, pulled: Path) -> None:
    """The file has one setting; it can be pushed, but not restored, which needs all."""
    partial_file = pulled.with_name("part")
    partial_file.write_text("; [VER:1.1f.20170801:]\n$27=2.5 (my switches)\n")
    assert ugrbl(bench, "push", partial_file, "--yes").exit_code == 0
    done = ugrbl(bench, "diff", pulled, "--json", "-")
    assert [row["number"] for row in json.loads(done.stdout)["changes"]] == [27]
    done = ugrbl(bench, "restore", partial_file, "--yes")
    assert done.exit_code == 1 and "the file has no $0, $1" in done.output


def test_factory_settings_are_restored(
    bench: Bench, pulled: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The old values are saved in factory.before, in the current folder."""
    monkeypatch.chdir(pulled.parent)
    edit(pulled, s130="777")
    assert ugrbl(bench, "push", pulled, "--yes").exit_code == 0
    done = ugrbl(bench, "restore", "--factory", "--yes")
    assert done.exit_code == 0, done.output
    assert "$130" in done.output and "200.000" in done.output
    assert "$130=777.000" in Path("factory.before").read_text()


# Files that do not fit


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("; [VER:0.9j.20160303:]\n$0=10\n", "the file is for Grbl 0.9j"),
        ("$0=10\n", "does not say which Grbl"),
        ("; [VER:1.1h.20190830:]\n$103=250\n", "the machine has no $103"),
    ],
)
def test_file_that_does_not_fit_is_refused(
    bench: Bench, tmp_path: Path, text: str, why: str
) -> None:
    file = tmp_path / "file"
    file.write_text(text)
    done = ugrbl(bench, "push", file, "--yes")
    assert done.exit_code == 1 and why in " ".join(done.output.split())


def test_file_of_unknown_origin_is_pushed_with_any_version(bench: Bench, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("$0=10\n")
    assert ugrbl(bench, "push", file, "--yes", "--any-version").exit_code == 0


def test_offsets_may_be_negative() -> None:
    assert Settings.read("$171=-0.5\n").values == {171: "-0.5"}
    assert meaning(171).name == "Y squaring offset"


@pytest.mark.parametrize("number", [780, 781, 782])
def test_skew_may_be_negative(number: int) -> None:
    assert Settings.read(f"${number}=-0.5\n").values == {number: "-0.5"}
    assert meaning(number).limits == "any number"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("$0=10\nG0 X1\n", "line 2 is no setting"),
        ("$0=ten\n", "line 1: $0 cannot be ten"),
        ("$0=-1\n", "line 1: $0 cannot be -1"),
        ("$0=\n", "cannot be nothing"),
        ("$0=nan\n", "cannot be nan"),
        ("$0=1\n$0=1\n", "line 2: $0 is there twice"),
    ],
)
def test_damaged_file_is_refused_with_the_line(text: str, why: str) -> None:
    with pytest.raises(SettingsError) as refused:
        Settings.read(text)
    assert why in str(refused.value)


def test_port_without_a_machine_is_named(tmp_path: Path) -> None:
    file = tmp_path / "file"
    done = CliRunner().invoke(app, ["settings", "pull", str(file), "--port", "/dev/nowhere"])
    assert done.exit_code == 1 and "/dev/nowhere" in done.output


# The file format


def test_older_file_formats_are_read() -> None:
    """As Grbl 0.9 prints settings, with names in parentheses."""
    settings = Settings.read(
        "[0.9j.20160303:]\n$0=10 (step pulse, usec)\n\n(mine)\n$110 = 500.000\n"
    )
    assert settings.values == {0: "10", 110: "500.000"}
    assert str(settings.firmware) == "Grbl 0.9j (20160303)"


def test_numbers_are_compared_as_grbl_prints_them() -> None:
    """Three decimals, and about seven digits of a 32-bit float."""
    machine = {11: "0.010", 100: "1234567.875", 0: "10"}
    assert changes(machine, {11: "0.0104", 100: "1234568", 0: "10.0"}) == []
    assert [c.number for c in changes(machine, {11: "0.011", 100: "1234600"})] == [11, 100]


def test_every_setting_of_the_firmware_has_a_meaning() -> None:
    for number in (0, 13, 32, 100, 112, 121, 132):
        assert meaning(number).name and meaning(number).unit
    assert meaning(999) == settings_file.Meaning("", "", "")


def test_letter_of_a_version_does_not_matter() -> None:
    """A file of 1.1f fits a machine with 1.1h."""
    ours = Settings(Firmware.read(GRBL), {0: "10"})
    theirs = Settings(Firmware.read(["; [VER:1.1f.20170801:mine]"]), {0: "12"})
    check_fit(theirs, ours, any_version=False, complete=True)
