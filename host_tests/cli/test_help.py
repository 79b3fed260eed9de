"""Test the help texts of `ugrbl` on a terminal of 80 columns."""

import re
from itertools import pairwise

import pytest
import typer
from typer.testing import CliRunner
from ugrbl.cli.app import app

_COLUMNS = 80


def names(command: object, name: str = "") -> "list[str]":
    """Return all commands, words separated by blanks; the whole program is an empty text."""
    below = getattr(command, "commands", {})
    return [name, *(one for sub in below for one in names(below[sub], f"{name} {sub}".strip()))]


NAMES = names(typer.main.get_command(app))
each_command = pytest.mark.parametrize("name", NAMES)


def help_of(name: str) -> str:
    environment = {"COLUMNS": str(_COLUMNS), "TERMINAL_WIDTH": str(_COLUMNS)}
    done = CliRunner().invoke(app, [*name.split(), "--help"], env=environment)
    assert done.exit_code == 0, done.output
    return done.output


def broken_early(text: str) -> "list[str]":
    """Return lines of a help text that end although the first word of the next line would fit.

    Only the prose before the list of arguments or options is looked at.
    """
    prose_text, *_ = re.split(r"\n.*(?:Arguments|Options|Examples?)\b.*\n", text)
    prose = [line.rstrip() for line in prose_text.splitlines()]
    return [
        line
        for line, following in pairwise(prose)
        if re.match(r" +\w", line)
        and re.match(r" +\w", following)
        and len(f"{line} {following.split()[0]}") <= _COLUMNS - 2
    ]


@each_command
def test_help_is_wrapped_to_the_terminals_width(name: str) -> None:
    text = help_of(name)
    assert "Usage:" in text
    assert max(map(len, text.splitlines())) <= _COLUMNS
    assert broken_early(text) == []


@pytest.mark.parametrize("name", ["", "custom", "job", "settings"])
def test_no_command_is_cut_short_in_a_list(name: str) -> None:
    listed = help_of(name).partition("Commands:")[2]
    assert listed and "..." not in listed


def test_line_broken_early_is_found() -> None:
    assert broken_early("  It is\n  short.\n") == ["  It is"]
    assert broken_early(f"  {'x' * 72} and\n  so on.\n") == []
