"""A report in a real browser: offline, narrow and wide."""

import io

import matplotlib.image
import pytest

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


@pytest.mark.parametrize("width", [400, 1400])
def test_nothing_sticks_out(open_page, report, width):
    """Neither the page nor a drawing is wider than the window, before the replay and with it."""
    widths = "[document.scrollingElement.scrollWidth, innerWidth]"
    with open_page(report, width, 900) as page:
        assert page.evaluate(widths) == [width, width]
        boxes = page.locator("figure img").evaluate_all(
            "all => all.map(each => [each.getBoundingClientRect().right, each.clientHeight])"
        )
        assert len(boxes) > 15
        assert all(right <= width and height > 100 for right, height in boxes)
        page.locator("#open-replay").click()
        page.locator("iframe").wait_for()
        assert page.evaluate(widths) == [width, width]


def test_the_replay_opens_when_it_is_asked_for(open_page, report):
    with open_page(report, 1400, 900) as page:
        assert page.locator("iframe").count() == 0
        page.locator("#open-replay").click()
        frame = page.frame_locator("iframe")
        frame.locator("canvas").first.wait_for()
        inner = page.frames[-1]
        inner.wait_for_function("viewer.animator.time > 0.1")
        page.locator("iframe").scroll_into_view_if_needed()
        picture = page.locator("iframe").screenshot()
    pixels = matplotlib.image.imread(io.BytesIO(picture), "png")[:, :, :3]
    assert (pixels.max(axis=2) > 0.3).mean() > 0.02  # something is drawn in the dark
