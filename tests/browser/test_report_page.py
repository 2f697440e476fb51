"""A report in a real browser: offline, narrow and wide, light and dark."""

import io

import numpy as np
import pytest
from PIL import Image

from cpid_drake.files.resources import models_directory
from cpid_drake.identification.identify_files import identify_files
from cpid_drake.identification.request import Request
from cpid_drake.report.contents import collect_contents
from cpid_drake.report.pages.identification import identification_report
from cpid_drake.spacecraft.reference import SpacecraftReference

pytestmark = pytest.mark.slow

FREE_FLYER = SpacecraftReference(
    str(models_directory() / "free_flyer/free_flyer.urdf"), "body", "capture_point"
)


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """The address of a report as `cpid identify --report` writes it."""
    folder = tmp_path_factory.mktemp("report")
    log = folder / "<img src=x onerror=alert(1)>.csv"
    log.write_bytes((models_directory() / "telemetry/free_flyer.csv").read_bytes())
    request = Request(str(log), FREE_FLYER, sensors="testbed", end=4.0)
    identification_report(collect_contents(identify_files([request]))).write(folder / "report.html")
    return (folder / "report.html").as_uri()


HEIGHT = 900  # of the window [px]
DRAWN = "document.querySelectorAll('.plot .main-svg').length > 0"


def pixels(picture: bytes) -> np.ndarray:
    """A screenshot, (height, width, 3) of 0 to 1."""
    return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")) / 255


def widths(page) -> list[int]:
    """The width of what can be scrolled, and that of the window."""
    return page.evaluate("[document.scrollingElement.scrollWidth, innerWidth]")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [400, 1400])
def test_the_first_screen_answers(open_page, report, width, scheme):
    """Sentence, numbers and bars are there at once, in the colours that the browser asks for."""
    with open_page(report, width, HEIGHT, scheme) as page:
        page.wait_for_function(DRAWN)
        heading = page.locator("h1").inner_text()
        assert heading.startswith(("m = 8.", "A check failed", "Checks failed"))
        figure = page.locator(".plot").first
        box = figure.bounding_box()
        assert box["y"] + box["height"] < HEIGHT
        numbers = figure.locator(".annotation-text").all_text_contents()
        assert len(numbers) == 10
        assert numbers[0].startswith("m")
        assert "kg" in numbers[0]
        assert widths(page) == [width, width]
        assert page.evaluate("document.scrollingElement.scrollHeight") < 3500
        picture = pixels(page.screenshot())
    paper = picture[2, 2]
    assert (paper.max() < 0.2) == (scheme == "dark")
    shown = picture[int(box["y"]) : int(box["y"] + box["height"])]
    assert 0.02 < (np.abs(shown - paper).max(axis=2) > 0.15).mean() < 0.6


def test_colours_follow_the_browser_while_the_page_is_open(open_page, report):
    """Also those of text in figures."""
    color = "getComputedStyle(document.querySelector('.plot .annotation-text')).fill"
    with open_page(report, 1400, HEIGHT) as page:
        page.wait_for_function(DRAWN)
        before = page.evaluate(color)
        page.emulate_media(color_scheme="dark")
        page.wait_for_function(f"{color} !== '{before}'")
        after = page.evaluate(f"getComputedStyle(document.body).color === {color}")
        assert after


@pytest.mark.parametrize("width", [400, 1400])
def test_links_open_what_is_folded_and_nothing_sticks_out(open_page, report, width):
    with open_page(report, width, HEIGHT) as page:
        folded = page.locator("details")
        assert folded.count() >= 6
        assert not any(folded.nth(k).get_attribute("open") for k in range(folded.count()))
        for k in range(folded.count()):
            name = folded.nth(k).get_attribute("id")
            page.locator(f'nav a[href="#{name}"]').click()
            page.wait_for_function(f"document.getElementById('{name}').open")
        for k in range(page.locator(".plot").count()):
            plot = page.locator(".plot").nth(k)
            plot.scroll_into_view_if_needed()
            plot.locator(".main-svg").first.wait_for()
            box = plot.bounding_box()
            assert box["x"] + box["width"] <= width
            assert box["height"] > 100
        assert widths(page) == [width, width]


@pytest.mark.parametrize("width", [400, 1400])
def test_the_scene_plays_by_itself(open_page, report, width):
    with open_page(report, width, HEIGHT) as page:
        page.frame_locator("iframe").locator("canvas").first.wait_for()
        page.frames[-1].wait_for_function("'viewer' in window && viewer.animator.time > 0.1")
        page.locator(".scene").scroll_into_view_if_needed()
        picture = pixels(page.locator(".scene").screenshot())
        assert widths(page) == [width, width]
    assert (picture.max(axis=2) > 0.3).mean() > 0.02  # something is drawn in the dark


def test_a_point_says_its_values(open_page, report):
    with open_page(report, 1400, HEIGHT) as page:
        page.wait_for_function(DRAWN)
        box = page.locator(".plot .point").first.bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.locator(".hoverlayer .hovertext").first.wait_for()
