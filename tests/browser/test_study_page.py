"""The report of the paper's study in a browser: on a phone and on a desk, light and dark."""

import pytest

pytestmark = pytest.mark.slow

CONTRAST = """() => {
    const parse = text => text.match(/[0-9.]+/g).slice(0, 3).map(Number);
    const light = text => parse(text).map(x => x / 255)
        .map(x => x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4)
        .reduce((sum, x, i) => sum + x * [0.2126, 0.7152, 0.0722][i], 0);
    const contrast = (a, b) =>
        (Math.max(light(a), light(b)) + 0.05) / (Math.min(light(a), light(b)) + 0.05);
    const found = {text: [], line: []};
    for (const figure of document.querySelectorAll("figure")) {
        const card = getComputedStyle(figure).backgroundColor;
        for (const text of figure.querySelectorAll("svg text"))
            found.text.push(contrast(getComputedStyle(text).fill, card));
        for (const path of figure.querySelectorAll('svg [id*="line2d"] path[clip-path]'))
            if (!path.getAttribute("style").includes("--grid"))
                found.line.push(contrast(getComputedStyle(path).stroke, card));
    }
    return found;
}"""
CUES = """() => [...document.querySelectorAll(".scroll")].map(box => {
    const cue = box.nextElementSibling, style = getComputedStyle(cue);
    return [box.scrollWidth > box.clientWidth + 1,
            cue.className === "cue" && style.display !== "none" && style.visibility !== "hidden"];
})"""
ALL_SEEN = """() => {
    for (const box of document.querySelectorAll(".scroll")) box.scrollLeft = box.scrollWidth;
    return [...document.querySelectorAll(".cue")]
        .every(cue => cue.hidden || cue.style.visibility === "hidden");
}"""


@pytest.fixture
def study_page(paper_run, new_page):
    """Return a function (width, colour scheme) -> page."""

    def open_(width: int, scheme: str = "light"):
        page = new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
        page.goto((paper_run.folder / "report.html").as_uri())
        return page

    return open_


@pytest.mark.parametrize(("scheme", "line"), [("light", 2.0), ("dark", 4.5)])
def test_figures_can_be_read(study_page, scheme, line):
    """Text as WCAG asks for, and lines that stand out from the card below them."""
    page = study_page(1400, scheme)
    contrast = page.evaluate(CONTRAST)
    assert page.locator("figure img").count() == 0
    assert len(contrast["text"]) > 200
    assert len(contrast["line"]) > 30
    assert min(contrast["text"]) > 4.5
    assert min(contrast["line"]) > line
    page.close()


def test_a_phone_shows_that_tables_continue(study_page):
    page = study_page(400)
    assert page.evaluate("document.scrollingElement.scrollWidth") == 400
    page.wait_for_function(f"({CUES})().every(([wide, cue]) => cue === wide)")
    boxes = page.evaluate(CUES)
    assert sum(wide for wide, _ in boxes) >= 2
    page.wait_for_function(ALL_SEEN)
    page.emulate_media(media="print")
    assert not page.locator(".cue").first.is_visible()
    page.close()


def test_a_desk_shows_tables_whole(study_page):
    page = study_page(1400)
    page.wait_for_function(f"!({CUES})().some(([wide, cue]) => wide || cue)")
    page.close()
