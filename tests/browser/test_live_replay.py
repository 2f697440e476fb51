"""`cpid live replay` in a browser: the estimate with its numbers, and the legend."""

import re

from flyer_cases import SAMPLE, SENSORS_OF_SAMPLE
from processes import start

COMMAND = (
    *("live", "replay", SAMPLE, "--spacecraft", "free_flyer_payload"),
    *("--sensors", SENSORS_OF_SAMPLE, "--rate", 0.5),
)
ESTIMATE = "!!viewer.scene_tree.find(['cpid', 'estimate', 'three_sigma']).object.visible"
IS_ON_TOP = """pattern => [...document.querySelectorAll("*")].some(row => {
    if (row.children.length || !new RegExp(pattern).test(row.textContent)) return false;
    const {x, y, width, height} = row.getBoundingClientRect();
    return row.contains(document.elementFromPoint(x + width / 2, y + height / 2));
})"""
"""Whether an element with a text is seen; each sample makes the page draw its rows anew."""


def test_the_page_shows_the_estimate_while_samples_arrive(open_page, tmp_path):
    process = start("-m", "cpid_drake", *COMMAND, cwd=tmp_path)
    try:
        for line in process.stderr:
            if found := re.search(r"Open (http\S+)", line):
                break
        with open_page(found.group(1), 900, 600) as page:
            page.wait_for_function(ESTIMATE)
            page.get_by_text("Open Controls").click()
            for shown in ("3 σ, ellipsoid of inertia", r"^m 8\.[0-9]+ kg ± 0"):
                page.wait_for_function(IS_ON_TOP, arg=shown)
            page.screenshot(path=tmp_path / "live.png")
    finally:
        process.kill()
        process.wait()
