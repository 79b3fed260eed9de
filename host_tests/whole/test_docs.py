"""The documents are true: tables, names, commands, links, quotes, pictures."""

import ast
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest
from ugrbl.boardfile import options
from ugrbl.cli.app import app
from ugrbl.docs import house, pages, pictures, ramp, words
from ugrbl.grbl import comments
from ugrbl.grbl.lines import split_lines
from ugrbl.grbl.messages import alarms, errors
from ugrbl.run.program import run_program

_ROOT = Path(__file__).resolve().parents[2]
_FIRMWARE = _ROOT / "firmware"
_README = _ROOT / "README.md"
_CONTENTS = _ROOT / "docs" / "README.md"
_DOCS = sorted((_ROOT / "docs").glob("*.md"))
_ALL = [_README, _ROOT / "CONTRIBUTING.md", *_DOCS]
_each_page = pytest.mark.parametrize("page", _ALL, ids=[page.stem for page in _ALL])

_LINK = re.compile(r"\]\(([^)\s]+)\)")
_HEADING = re.compile(r"^#+ (.*)$", re.MULTILINE)
_FENCE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
_CODE = re.compile(r"`([^`\n]+)`|^ {4}(\S.*)$", re.MULTILINE)
_PATH = re.compile(r"(?<![\w/])(?:firmware|host_tests|tools|docs|examples|boards)/[\w./-]*")
_RELEASE = re.compile(r"^## \[(Unreleased|[^]]+\] - \d{4}-\d{2}-\d{2})", re.MULTILINE)

# Files that a reader writes when following a page; they are not in the tree.
_WRITTEN_BY_READERS = {"boards/mine.py", "boards/my_router.py"}


def text_of(page):
    return page.read_text(encoding="utf-8")


def reference():
    return text_of(_ROOT / "docs" / "reference.md")


def not_in_code(names, text):
    return [name for name in names if f"`{name}`" not in text]


# Tables


def test_the_tables_are_up_to_date():
    for page in pages.PAGES:
        assert pages.update(text_of(page)) == text_of(page), f"{page.name}: make docs"


def test_every_table_has_exactly_one_place():
    text = "".join(map(text_of, pages.PAGES))
    for name in pages.TABLES:
        assert text.count(f"<!-- begin: {name} -->") == 1
        assert text.count(f"<!-- end: {name} -->") == 1


def test_every_code_is_in_the_reference():
    """docs/reference.md lists exactly the codes that the firmware accepts: numbers up to 255."""
    from extras.custom_codes import is_grbls

    documented = words.g_words() + words.m_words()  # as the reference's tables list them
    numbers = {(word[0], int(word[1:].partition(".")[0])) for word in documented}
    # is_grbls() wants ten times the number: 382 is G38.2.
    assert numbers == {
        (letter, number)
        for letter in "GM"
        for number in range(256)
        if any(is_grbls(letter, 10 * number + tenth) for tenth in range(10))
    }
    assert not_in_code(documented, reference()) == []


def test_every_command_and_byte_is_in_the_reference():
    """The letters of $ commands as `$G`, and the bytes of real-time commands as `0x85`."""
    from base import state
    from control import overrides, realtime

    letters = [command[1] for command in words.commands()]  # of "$G" and the others
    assert len(letters) == 10
    assert [letter for letter in letters if f"`${letter}" not in reference()] == []
    numbers = [realtime._SOFT_RESET, *state.EVENTS, *overrides._OVERRIDES]
    assert not_in_code([f"0x{number:02X}" for number in numbers], reference()) == []


def test_every_setting_has_a_comment_and_is_in_the_reference():
    """The comments are those of tools/docs, in the order of the firmware's settings table."""
    from base import settings

    numbers = [row[0] for row in settings._TABLE]
    assert list(comments.setting_comments()) == numbers
    assert not_in_code([f"${number}" for number in numbers], reference()) == []


def test_every_error_and_alarm_is_in_the_reference():
    assert not_in_code([f"error:{number}" for number in errors()], reference()) == []
    assert not_in_code([f"ALARM:{number}" for number in alarms()], reference()) == []


def test_every_board_is_in_the_page_of_boards():
    files = [path.name for path in (_ROOT / "boards").glob("[!_]*.py")]
    assert not_in_code(files, text_of(_ROOT / "docs" / "boards.md")) == []


def test_every_board_option_is_in_the_reference():
    assert not_in_code(options.BY_NAME, reference()) == []


def test_a_row_without_a_comment_is_named(monkeypatch):
    table = f"T: \"{comments._TABLE_TYPE}\" = (\n    (7, 'x'),\n)\n"
    monkeypatch.setattr(comments, "source", lambda module: table)
    with pytest.raises(ValueError, match=r"\$7 has no comment"):
        comments.setting_comments()


# Size and links


def test_the_readme_is_short():
    assert _README.stat().st_size <= 6_000


def test_the_readme_counts_the_lines_of_the_example():
    lines = text_of(_ROOT / "examples" / "badge.nc").splitlines()
    assert f"({len(lines)} lines)" in text_of(_README)


def test_the_contents_link_every_page_once():
    links = [link for link in _LINK.findall(text_of(_CONTENTS)) if not link.startswith("..")]
    assert sorted(links) == [page.name for page in _DOCS if page != _CONTENTS]


def anchors(page):
    """Return the anchors of a page's headings, as GitHub makes them from their text."""
    text = _FENCE.sub("", text_of(page))
    return {
        re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        for heading in _HEADING.findall(text)
    }


@_each_page
def test_every_link_has_a_target(page):
    """A link, path#anchor, names a file and a heading in it; links to the web are not tried."""
    for link in _LINK.findall(text_of(page)):
        if "://" not in link:
            path, _, anchor = link.partition("#")
            target = page.parent / path if path else page
            assert target.exists(), link
            assert not anchor or anchor in anchors(target), link


# Files and commands


def code_of(page):
    """Return the code of a page: inline, and in indented lines."""
    return [one or other for one, other in _CODE.findall(_FENCE.sub("", text_of(page)))]


@_each_page
def test_every_named_file_exists(page):
    named = {path for code in code_of(page) for path in _PATH.findall(code)} - _WRITTEN_BY_READERS
    assert [name for name in named if not (_ROOT / name).exists()] == []


def known_commands():
    """Return a dict: each command (the words after `ugrbl`), to the set of its options."""
    import typer

    options_of = {}

    def collect(command, name):
        """Add a command and, recursively, its subcommands. name: "" for `ugrbl` itself."""
        options_of[name] = {option for one in command.params for option in (*one.opts, "--help")}
        # Secondary options are those that switch a flag off: --no-color.
        options_of[name] |= {option for one in command.params for option in one.secondary_opts}
        for sub, below in getattr(command, "commands", {}).items():
            collect(below, f"{name} {sub}".strip())

    collect(typer.main.get_command(app), "")
    return options_of


_COMMANDS = known_commands()
_TARGETS = set(re.findall(r"^([a-z-]+):", text_of(_ROOT / "Makefile"), re.MULTILINE))


def unknown_words(line):
    """Yield the commands and options in a line of code that do not exist.

    A command is one or two words after `ugrbl`, like `bench` or `jobs list`; or a make target.
    """
    for after_ugrbl in re.findall(r"(?:^|\s|/)ugrbl +([a-z][^|·]*)", line):
        parts = after_ugrbl.split()
        name = " ".join(parts[:2]) if " ".join(parts[:2]) in _COMMANDS else parts[0]
        if name not in _COMMANDS:
            yield f"ugrbl {name}"
            continue
        options = [part.partition("=")[0].strip("[]") for part in parts if part.startswith("--")]
        yield from (f"{name} {option}" for option in options if option not in _COMMANDS[name])
    for target in re.findall(r"^make ([a-z-]+)", line):
        if target not in _TARGETS:
            yield f"make {target}"


def test_unknown_words_are_found():
    assert list(unknown_words("ugrbl bench")) == ["ugrbl bench"]
    assert list(unknown_words(".venv/bin/ugrbl run x.nc --chek")) == ["run --chek"]
    assert list(unknown_words("ugrbl settings pull router.settings --force")) == []
    assert list(unknown_words("make everything")) == ["make everything"]


@_each_page
def test_every_command_exists(page):
    assert [wrong for code in code_of(page) for wrong in unknown_words(code)] == []


def test_every_command_has_a_section_in_command_line():
    """The page's table and its sections are the same commands; a section may describe two ("a
    and b"). Subcommands, like `list` in `jobs list`, are named in their command's section."""
    text = text_of(_ROOT / "docs" / "command-line.md")
    table = re.findall(r"`ugrbl ([a-z0-9-]+)`\]\(#", text)
    sections = dict(re.findall(r"^## (.+)\n((?:(?!## ).*\n)*)", text, re.MULTILINE))
    bodies = {name: body for title, body in sections.items() for name in title.split(" and ")}
    assert (
        sorted(table) == sorted(bodies) == sorted({name.split()[0] for name in _COMMANDS if name})
    )
    subcommands = [name.split() for name in _COMMANDS if " " in name]
    assert subcommands and all(
        re.search(rf"`{sub}\b|{name} {sub}", bodies[name]) for name, sub in subcommands
    )


@pytest.mark.parametrize("name", ["test", "release"])
def test_commands_of_the_workflows_exist(name):
    """GitHub's workflows call `ugrbl` and `make` only with commands that exist."""
    text = text_of(_ROOT / ".github" / "workflows" / f"{name}.yml")
    lines = [line.strip().removeprefix("- ").removeprefix("run: ") for line in text.splitlines()]
    called = [line for line in lines if re.match(r"(ugrbl|make|\.venv/bin/ugrbl) ", line)]
    assert called
    assert [wrong for line in called for wrong in unknown_words(line)] == []


# Quotes of tool messages in troubleshooting.md, with … for variable parts


def quotes(heading):
    """Return the messages quoted in a section's table of docs/troubleshooting.md, first column."""
    section = re.search(
        rf"^## {heading}$(.*?)(^## |\Z)",
        text_of(_ROOT / "docs" / "troubleshooting.md"),
        re.MULTILINE | re.DOTALL,
    )[1]
    rows = [line for line in section.splitlines() if line.startswith("| `")]
    return [quote for row in rows for quote in re.findall(r"`([^`]+)`", row.split(" | ")[0])]


def texts_in(*folders):
    """Return every text in these modules as it is shown; variable parts become …."""
    texts = []
    for path in sorted(file for folder in folders for file in (_ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(text_of(path))):
            if isinstance(node, ast.JoinedStr):
                parts = (getattr(part, "value", None) for part in node.values)
                texts.append("".join(part if isinstance(part, str) else "…" for part in parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append(re.sub(r"%\w", "…", node.value))
    return texts


@pytest.mark.thorough
@pytest.mark.parametrize("heading", ["Deploying", "What the doctor says"])
def test_quoted_messages_exist_in_the_tools(heading):
    """Each part of a quoted message between "…" must be in some text of the program."""
    quoted = quotes(heading)
    assert len(quoted) >= 8
    texts = texts_in("tools", "firmware")
    parts = [part.strip() for quote in quoted for part in quote.split("…") if part.strip(" .:,")]
    assert [part for part in parts if not any(part in text for text in texts)] == []


# Names


def members(body):
    """Yield every name that statements define; methods and attributes of objects as Class.name."""
    for node in body:
        if isinstance(node, ast.FunctionDef):
            yield node.name
        elif isinstance(node, ast.ClassDef):
            yield node.name
            yield from (f"{node.name}.{name}" for name in members(node.body))
            yield from (f"{node.name}.{name}" for name in attributes(node))
        elif isinstance(node, ast.Assign):
            yield from (ast.unparse(target) for target in node.targets)
        elif isinstance(node, ast.AnnAssign):
            yield ast.unparse(node.target)


def attributes(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            if ast.unparse(node.value) == "self":
                yield node.attr


def module_path(name):
    """Return a module's path from its name, `minifloat`, or with its folder, `pio.engine`.

    None if there is no such module, or more than one.
    """
    file = name.replace(".", "/") + ".py"
    paths = [path for path in (_FIRMWARE / file, *_FIRMWARE.glob(f"*/**/{file}")) if path.exists()]
    return paths[0] if len(paths) == 1 else None


def exists(name):
    """Return whether the firmware has this name: module, with or without folder, and member."""
    parts = name.split(".")
    for count in range(len(parts) - 1, 0, -1):
        path = module_path(".".join(parts[:count]))
        if path:
            return ".".join(parts[count:]) in members(ast.parse(text_of(path)).body)
    return False


def stories():
    """Return the stories of architecture.md by their headings."""
    text = text_of(_ROOT / "docs" / "architecture.md")
    parts = re.split(r"^## (The life of .*)$", text, flags=re.MULTILINE)[1:]
    return dict(zip(parts[::2], (part.split("\n## ")[0] for part in parts[1::2]), strict=True))


_NAME = re.compile(r"`([a-z_]\w*(?:\.\w+)+)`")
# The path of a line through the firmware: the story must name all of these modules.
_STATIONS = set("protocol lines interpreter words block checks canon planner segments".split())
_STATIONS |= {"plan_kernel", "segment_kernel"}


def test_names_are_looked_up_in_the_firmware():
    """exists(), which checks the names in the documents, finds members, and misses others."""
    assert exists("state.State.pending")
    assert exists("segment_kernel.fill")
    assert exists("pio.engine.PioEngine.stop")
    assert not exists("segment_kernel.fil")
    assert not exists("nobody.knows")


def test_architecture_has_five_stories():
    assert len(stories()) == 5


def test_every_name_in_a_story_exists():
    for title, story in stories().items():
        names = [name for name in _NAME.findall(story) if not name.endswith((".py", ".md"))]
        assert len(names) > 5, title
        assert [name for name in names if not exists(name)] == [], title


def test_the_story_of_a_g1_names_every_module_on_its_path():
    names = _NAME.findall(stories()["The life of a G1"])
    assert {name.partition(".")[0] for name in names} >= _STATIONS


# Decisions


def test_every_decision_has_its_three_parts_and_is_short():
    """Each section of the page has these three paragraphs, in 6 to 12 lines that are not empty."""
    text = text_of(_ROOT / "docs" / "decisions.md")
    for decision in text.split("\n## ")[1:]:
        parts = re.findall(r"^\*(\w+)\.\*", decision, re.MULTILINE)
        assert parts == ["Context", "Decision", "Consequence"], decision
        lines = [line for line in decision.splitlines()[1:] if line]
        assert 6 <= len(lines) <= 12, decision


# The module graph as drawn

# Imports for mypy only, against the arrows. The set must become empty, and must not grow.


def drawn_arrows():
    text = text_of(_ROOT / "docs" / "architecture.md")
    drawing = re.search(r"^```mermaid$(.*?)^```$", text, re.MULTILINE | re.DOTALL)[1]
    return set(re.findall(r"^ *(\w+)(?:\[[^]]*\])? --> (\w+)$", drawing, re.MULTILINE))


def reachable(arrows):
    """Return all pairs connected by a chain of arrows."""
    pairs = set(arrows)
    while True:
        indirect = {(a, d) for a, b in pairs for c, d in pairs if b == c} - pairs
        if not indirect:
            return pairs
        pairs |= indirect


def test_the_drawn_graph_matches_the_imports():
    drawn, real = drawn_arrows(), house.imports()
    assert {name for pair in drawn for name in pair} == set(house.FOLDERS)
    assert drawn - real == set(), "an arrow without an import"
    assert real - reachable(drawn) == set(), "an import without a chain of arrows"


def test_no_redundant_arrow_is_drawn():
    drawn = drawn_arrows()
    assert [arrow for arrow in drawn if arrow in reachable(drawn - {arrow})] == []


def test_the_imports_have_no_cycle():
    pairs = reachable(house.imports())
    assert [pair for pair in pairs if pair[0] == pair[1]] == []


def test_every_folder_of_the_firmware_is_in_the_graph():
    folders = {path.parent.name for path in _FIRMWARE.glob("*/*.py")}
    assert folders == set(house.FOLDERS)


# Pictures


_PICTURES = [
    *(picture.name for picture in pictures.PICTURES),
    *pictures.OF_THE_PAGE,
    ramp.NAME,
]


@pytest.mark.parametrize("name", _PICTURES)
def test_a_picture_is_small_and_used(name):
    assert (pictures.FOLDER / name).stat().st_size < pictures.MOST_BYTES
    assert any(f"pictures/{name}" in text_of(page) for page in _ALL)


@pytest.mark.sampled(0, 8)
@pytest.mark.parametrize("picture", pictures.PICTURES, ids=lambda picture: picture.name)
def test_a_picture_is_up_to_date(picture, tmp_path):
    fresh = tmp_path / picture.name
    pictures.draw(picture, fresh)
    assert pictures.same(fresh, pictures.FOLDER / picture.name), "make pictures"


@pytest.mark.skipif(not ramp.RECORDING.is_file(), reason="the recordings are not here")
def test_the_picture_of_a_ramp_is_up_to_date(tmp_path):
    """And shows what docs/speed.md says: Grbl's speed jumps, ours does not."""
    fresh = tmp_path / ramp.NAME
    ramp.draw(fresh)
    assert pictures.same(fresh, pictures.FOLDER / ramp.NAME), "make pictures"
    largest_jump = {}
    for name, times in (("Grbl", ramp.grbl_ms()), ("ours", ramp.our_ms())):
        # times: of the steps, in ms. speeds() returns (times, speeds).
        rates = ramp.speeds([ms for ms in times if ms <= ramp.grbl_ms()[-1]])[1]
        # The largest jump between two speeds, without the coarse first eight of the start.
        largest_jump[name] = max(abs(b - a) for a, b in pairwise(rates[8:]))
    assert largest_jump["ours"] < largest_jump["Grbl"] / 3


def test_there_are_no_other_pictures():
    assert {path.name for path in pictures.FOLDER.iterdir()} == set(_PICTURES)


def test_docs_reports_its_result():
    done = subprocess.run(
        [sys.executable, "-m", "ugrbl.docs"], capture_output=True, text=True, check=True
    )
    assert "reference.md is up to date" in done.stdout


# The changelog


def test_the_changelog_has_only_standard_sections():
    text = text_of(_ROOT / "CHANGELOG.md")
    assert _RELEASE.search(text)
    kinds = set(re.findall(r"^### (\w+)", text, re.MULTILINE))
    assert kinds <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}


# Words that senders search for

# Answers that consist of these words; no other text may contain them.
_ANSWERS = ("OK", "_ERROR")
_TAKEN = re.compile("ok|error", re.IGNORECASE)


def strings(tree):
    """Yield every text in a module except docstrings and the answers themselves.

    The answers are the values of the constants named in _ANSWERS.
    """
    hidden = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            hidden.add(id(node.value))
        elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) in _ANSWERS:
            hidden.update(id(part) for part in ast.walk(node.value))
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and id(node) not in hidden:
            if isinstance(node.value, (str, bytes)):
                text = node.value
                yield text.decode("latin-1") if isinstance(text, bytes) else text


def annotations(tree):
    """Yield annotations written as text."""
    for node in ast.walk(tree):
        for part in (getattr(node, "annotation", None), getattr(node, "returns", None)):
            if isinstance(part, ast.Constant):
                yield part.value


def sent_texts(module):
    """Yield texts that a module may send unchanged: report's texts, and all arguments of
    messages."""
    tree = ast.parse(text_of(_FIRMWARE / module))
    if module == "talk/report.py":
        types = set(annotations(tree))
        yield from (text for text in strings(tree) if text not in types)
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("message"):
            yield from strings(node)
        elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]).startswith("MSG_"):
            yield from strings(node)


def test_no_message_contains_an_answer():
    """A sender may look for `ok` or `error` anywhere in a line.

    The two texts at first show that sent_texts() does find messages and reports.
    """
    modules = [path.relative_to(_FIRMWARE).as_posix() for path in _FIRMWARE.rglob("*.py")]
    texts = [text for module in modules for text in sent_texts(module)]
    assert "Pgm End" in texts
    assert "ALARM:%d\r\n" in texts
    assert [text for text in texts if _TAKEN.search(text)] == []


def test_build_info_names_grbl_and_no_other_firmware():
    result, _ = run_program(split_lines(b"$I"))
    answer = "".join(text for _, text in result.other_output)
    assert "Grbl" in answer
    assert "grblhal" not in answer.lower()
