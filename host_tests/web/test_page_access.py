"""Test the page without a mouse, with a screen reader, and enlarged.

A `person` uses the page in a browser that is connected to a simulated machine. pauses() takes
seconds; evaluate() runs JavaScript and returns its value; CUT_OFF finds controls beyond the right
edge, _UNNAMED controls without a name, _USABLE the names of all enabled controls, and _FOCUSED
name and outline of the focused one.
"""

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
    """Parts that are hidden at first are included: the macro editor and the tool change."""
    person.click("#macros-edit")
    person.click("#macro-add")
    for tab in TABS:
        person.click(f"#tabs [data-tab={tab}]")
        person.pauses(0.2)
        assert not person.page.evaluate(_UNNAMED), tab
    person.click("#tabs [data-tab=job]")
    person.loads("M6\n")  # opens the dialog of a tool change
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
    """Tab is pressed until each control has had the focus; each must then have an outline."""
    person.click(f"#tabs [data-tab={tab}]")
    person.pauses(0.3)
    wanted_names = person.page.evaluate(_USABLE)
    person.page.evaluate("document.activeElement.blur(); scrollTo(0, 0)")
    outlines = {}
    # Some stops, such as those of the browser itself, are not in wanted_names.
    for _ in range(len(wanted_names) + 40):
        person.page.keyboard.press("Tab")
        name, outline = person.page.evaluate(_FOCUSED)
        outlines[name] = outline
    assert set(wanted_names) <= set(outlines)
    # Each focused control is outlined.
    assert {outlines[name] for name in wanted_names} == {"solid"}
