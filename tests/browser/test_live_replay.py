"""`cpid live replay` in a browser: the estimate with its numbers, and the legend."""

import re

from processes import start

from cpid_drake.files.resources import models_directory

FOLDER = models_directory() / "telemetry"
COMMAND = (
    *("live", "replay", FOLDER / "free_flyer.csv", "--scenario", "free_flyer_payload"),
    *("--sensors", FOLDER / "free_flyer_sensors.yaml", "--rate", 0.5),
)
ESTIMATE = "!!viewer.scene_tree.find(['cpid', 'estimate', 'three_sigma']).object.visible"


def test_the_page_shows_the_estimate_while_samples_arrive(open_page, tmp_path):
    process = start("-m", "cpid_drake", *COMMAND, cwd=tmp_path)
    try:
        for line in process.stderr:
            if found := re.search(r"Open (http\S+)", line):
                break
        with open_page(found.group(1), 900, 600) as page:
            page.wait_for_function(ESTIMATE)
            page.wait_for_function("document.body.innerText.includes('ellipsoid of inertia')")
            page.wait_for_function("/m 8\\.[0-9]+ kg ±/.test(document.body.innerText)")
            page.screenshot(path=tmp_path / "live.png")
    finally:
        process.kill()
        process.wait()
