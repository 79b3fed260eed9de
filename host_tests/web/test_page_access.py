"""Test the page without a mouse, with a screen reader, and enlarged."""

import pytest
from browser import CUT_OFF

pytestmark = [pytest.mark.xdist_group("page"), pytest.mark.thorough]

TABS = ("job", "console", "settings", "offsets", "setup")


def test_page_is_usable_at_200_percent_and_stop_stays_visible(person_at):
    """A browser's zoom of 200 % halves the pixels that the page has."""
    person = person_at(on={"viewport": {"width": 640, "height": 450}, "device_scale_factor": 2})
    person.open_from_disk()
    person.connect()
    for tab in ("machine", *TABS):
        person.click(f"#tabs [data-tab={tab}]")
        person.pauses(0.2)
        assert person.page.evaluate("document.documentElement.scrollWidth") <= 640, tab
        assert not person.page.evaluate(CUT_OFF)
        person.page.evaluate("scrollTo(0, document.documentElement.scrollHeight)")
        box = person.page.locator("#stop").bounding_box()
        assert box["height"] >= 60 and 0 <= box["y"] <= 450 - 60, "it does not scroll away"


_UNNAMED = """() => [...document.querySelectorAll("button, input, select, textarea, [tabindex]")]
    .filter((control) => control.checkVisibility() && ![control.ariaLabel,
        control.textContent, ...[...control.labels || []].map((label) => label.textContent)]
        .some((text) => text?.trim()))
    .map((control) => control.outerHTML.slice(0, 120))"""


def test_every_control_has_name_for_screen_reader(person):
    person.click("#macros-edit")
    person.click("#macro-add")
    for tab in TABS:
        person.click(f"#tabs [data-tab={tab}]")
        person.pauses(0.2)
        assert not person.page.evaluate(_UNNAMED), tab
    person.click("#tabs [data-tab=job]")
    person.loads("M6\n")
    person.click("#run")
    person.waits("!document.getElementById('tool-change').hidden")
    assert not person.page.evaluate(_UNNAMED)


# Controls that a person sees and may use, and that a key press has to reach.
_USABLE = """() => [...document.querySelectorAll("button, input, select, summary, [tabindex]")]
    .filter((control) => control.checkVisibility() && !control.disabled && control.tabIndex >= 0)
    .map((control) => control.id || control.ariaLabel || control.textContent.trim())"""
_FOCUSED = """() => {
    const control = document.activeElement, label = control.closest(".file");
    const style = getComputedStyle(label || control);
    return [control.id || control.ariaLabel || control.textContent.trim(), style.outlineStyle];
}"""


@pytest.mark.parametrize("tab", TABS)
def test_tab_key_reaches_every_control_and_shows_where_it_is(person, tab):
    person.click(f"#tabs [data-tab={tab}]")
    person.pauses(0.3)
    wanted = person.page.evaluate(_USABLE)
    person.page.evaluate("document.activeElement.blur(); scrollTo(0, 0)")
    reached = {}
    for _ in range(len(wanted) + 40):
        person.page.keyboard.press("Tab")
        name, outline = person.page.evaluate(_FOCUSED)
        reached[name] = outline
    assert set(wanted) <= set(reached)
    assert {reached[name] for name in wanted} == {"solid"}
