"""`cpid live replay` in a browser: numbers, curves and scene, live and after the end."""

import re

import numpy as np
import pytest
from flyer_cases import SAMPLE, SENSORS_OF_SAMPLE
from processes import HUNG, start

COMMAND = ("-m", "cpid_drake", "live", "replay")
CRAFT = ("--spacecraft", "free_flyer_payload", "--sensors", SENSORS_OF_SAMPLE)
ESTIMATE = "!!viewer.scene_tree.find(['cpid', 'estimate', 'three_sigma']).object.visible"
CHARTS = "[...document.querySelectorAll('.chart')]"
LENGTHS = f"{CHARTS}.map(chart => chart.data?.at(-1)?.x.length ?? 0)"
"""Number of points of the last curve of each chart."""

SIDEWAYS = "document.documentElement.scrollWidth > innerWidth"


@pytest.fixture
def replay(tmp_path):
    """Return a function that starts a replay of a log: (process, address of its page)."""
    started = []

    def make(*options, log=SAMPLE):
        process = start(*COMMAND, log, *CRAFT, *options, cwd=tmp_path)
        started.append(process)
        for line in process.stderr:
            if found := re.search(r"Open (http\S+)", line):
                return process, found[1]
        raise AssertionError("no address")

    yield make
    for each in started:
        each.kill()
        each.wait()


def is_in_first_screen(page, selector: str) -> bool:
    box, height = page.locator(selector).bounding_box(), page.viewport_size["height"]
    return box is not None and box["y"] >= 0 and box["y"] + box["height"] <= height


def test_the_page_shows_the_estimate_while_samples_arrive(open_page, replay):
    """Curves grow, the scene has the ellipsoid of 3 σ, and the mass is a number with its band."""
    _, address = replay("--rate", 0.5)
    assert address.startswith("http://127.0.0.1:")
    with open_page(address, 900, 900) as page:
        page.wait_for_selector("#scene")
        page.frames[1].wait_for_function(ESTIMATE)
        page.locator("#mass", has_text=re.compile(r"^m = 8\.\d+ ± 0\.\d+ kg$")).wait_for()
        page.wait_for_function(f"Math.min(...{LENGTHS}) > 0")
        before = page.evaluate(LENGTHS)
        assert len(before) == 11
        page.wait_for_function(f"{LENGTHS}.every((n, k) => n > {before}[k])", polling=200)
        assert "s late" in page.locator("#status").inner_text()
        assert page.locator("#end").is_hidden()
        names = page.evaluate(f"{CHARTS}.at(-1).data.map(curve => curve.name)")
        assert set(names) == {"attitude", "gyro", "position"}


@pytest.mark.parametrize(("width", "height"), [(1400, 900), (400, 800)])
def test_with_wait_the_page_stays_until_enter(open_page, replay, width, height):
    """Who opens it after the end sees everything; it keeps the numbers when the command ends."""
    process, address = replay("--rate", 100, "--wait", "--quiet")
    text = f"{address} is open until Enter"
    assert process.stdout.read(len(text)) == text
    with open_page(address, width, height, "dark") as page:
        page.get_by_text("The page stays until the command is closed").wait_for()
        page.wait_for_function(f"Math.min(...{LENGTHS}) > 1")
        assert page.locator("#mass").inner_text().startswith("m = 8.49")
        assert page.locator("#verdict").inner_text() == "all checks passed"
        assert not page.evaluate(SIDEWAYS)
        for selector in ("#mass", "#verdict", "section:first-child"):
            assert is_in_first_screen(page, selector), selector
        dark = page.evaluate("getComputedStyle(document.documentElement).backgroundColor")
        assert max(map(int, re.findall(r"\d+", dark)[:3])) < 50
        process.stdin.write("\n")
        process.stdin.flush()
        page.get_by_text("these are the last values").wait_for()
        assert process.wait(HUNG) == 0
        assert page.locator("#scene").count() == 0
        assert not page.evaluate(SIDEWAYS)


def test_a_browser_that_goes_away_does_not_end_the_run(open_page, replay):
    process, address = replay("--rate", 2)
    with open_page(address) as page:
        page.wait_for_function(f"Math.max(...{LENGTHS}) > 1")
    assert process.wait(HUNG) == 0
    assert "Target, by recursive_fit, from 4004 samples" in process.stdout.read()


def test_without_wait_the_page_says_that_the_run_has_ended(open_page, replay):
    process, address = replay("--rate", 2)
    with open_page(address) as page:
        page.get_by_text("these are the last values").wait_for()
        assert process.wait(HUNG) == 0
        assert page.locator("#mass").inner_text().startswith("m = 8.49")


def test_a_wrong_unit_is_named(open_page, replay, tmp_path):
    rows = SAMPLE.read_text().splitlines()
    start = next(k for k, row in enumerate(rows) if row.startswith("time,"))
    names = rows[start].split(",")
    for k in range(start + 1, len(rows)):
        cells = dict(zip(names, rows[k].split(","), strict=True))
        for name in ("bwx", "bwy", "bwz"):
            cells[name] = cells[name] and repr(float(cells[name]) * 180 / np.pi)
        rows[k] = ",".join(cells.values())
    (tmp_path / "degrees.csv").write_text("\n".join(rows))
    _, address = replay("--rate", 100, "--wait", "--quiet", log=tmp_path / "degrees.csv")
    with open_page(address, 400, 800) as page:
        page.get_by_text("the angular velocity is in degrees per second").wait_for()
        page.get_by_text("1001 of gyro").wait_for()
        assert page.locator("#verdict").inner_text() == "a check failed"
        assert is_in_first_screen(page, "#problems")
        assert not page.evaluate(SIDEWAYS)
