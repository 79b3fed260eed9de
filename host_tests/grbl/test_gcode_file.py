"""Program files: comments are sanitized, problems are refused with their line number."""

import io
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ugrbl.grbl import gcode_file
from ugrbl.grbl.gcode_file import check_text, comment, has_realtime, problems, sanitize
from ugrbl.grbl.lines import split_lines


@pytest.mark.parametrize(
    ("line", "sent"),
    [
        ("G1 X1 (Nut fräsen)", b"G1 X1 (Nut frasen)"),
        ("G1 X1 ; Ä Ö à – Größe!", b"G1 X1 ; A O a  Grosse."),
        ("(really? ~5 mm!) G0 X1", b"(really. -5 mm.) G0 X1"),
        ("(日本語)G1 X1", b"()G1 X1"),
        ("(open Ä", b"(open A"),
        ("(a; Ä) X1 ; (Ö", b"(a; A) X1 ; (O"),
        ("(caf\u00e9) M3", b"(cafe) M3"),
        ("G1 X1 (plain, nothing to do)", b"G1 X1 (plain, nothing to do)"),
    ],
)
def test_comments_are_sanitized_and_code_is_kept(line: str, sent: bytes) -> None:
    assert sanitize(line.encode("utf-8")) == sent


def test_a_latin_1_comment_is_sanitized() -> None:
    assert sanitize("G1 (Fräser)".encode("latin-1")) == b"G1 (Fraser)"


@given(st.binary(max_size=60))
def test_comments_never_contain_realtime_characters_after_sanitizing(line: bytes) -> None:
    line = line.replace(b"\n", b"").replace(b"\r", b"")
    found_problems = problems([line])
    # a problem outside comments is refused, not sanitized
    if not found_problems or found_problems[0].in_comment:
        assert not has_realtime(sanitize(line))


def test_problems_name_the_line_and_the_character() -> None:
    lines = ["G21", "(Ä)", "G1 X10°", "M0 !", "G1 (x?) X1", "\x18"]
    found_problems = problems([line.encode("utf-8") for line in lines])
    # line, and whether it is in a comment
    assert [(problem.line, problem.in_comment) for problem in found_problems] == [
        (2, True),
        (3, False),
        (4, False),
        (5, True),
        (6, False),
    ]
    assert "'Ä'" in found_problems[0].text and "'°'" in found_problems[1].text
    assert "feed hold" in found_problems[2].text and "reset" in found_problems[4].text


def test_a_utf_8_byte_order_mark_is_skipped(tmp_path: Path) -> None:
    file = tmp_path / "program.nc"
    file.write_bytes(b"\xef\xbb\xbfG21\r\nG0 X1\r\n")
    assert list(gcode_file.read_lines(file)) == [b"G21", b"G0 X1"]


def test_a_program_is_read_from_stdin(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(b"G21\nG0 X1\n")))
    assert list(gcode_file.read_lines(Path("-"))) == [b"G21", b"G0 X1"]


def test_comment_texts_are_extracted_for_display() -> None:
    assert comment(b"M0 (change to 3 mm)") == "change to 3 mm"
    assert comment("M0 ; Fräser 3 mm".encode()) == "Fräser 3 mm"
    assert comment(b"M0") == ""


@pytest.mark.parametrize(("data", "why"), [(b"\n \n", "empty"), (b"G21\nPK\0\3\4\n", "line 2")])
def test_a_file_without_a_program_is_refused(data: bytes, why: str) -> None:
    with pytest.raises(gcode_file.NotText, match=why):
        check_text(split_lines(data), "job.nc")
