"""The scripts in diagrams/ run from anywhere, and fail in one line."""

import re
import subprocess
from base64 import b64decode
from functools import cache

import matplotlib.image
import numpy as np
import pytest
from processes import ROOT, finish, start

FOLDER = ROOT / "diagrams"
SCRIPTS = sorted(path.name for path in FOLDER.glob("*.py"))
ARGUMENTS = {
    "paper_case.py": ["--graph", "diagram.dot"],
    "online_identification.py": [],
    "sensor_identification.py": [],
    "own_spacecraft.py": [],
    "adaptive_control.py": ["--figure", "errors.png", "--html", "adaptive.html"],
    "plan_identify_replan.py": ["--figure", "loop.png"],
    "meshcat_view.py": ["--html", "view.html"],
}
QUICK = "online_identification.py"
"""The script that the quick tests run."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("elsewhere")


@pytest.fixture(scope="module")
def ran(folder):
    """Return a function that runs a script for real, in a folder of its own, and but once."""

    @cache
    def run(script: str) -> subprocess.CompletedProcess:
        return finish(start(FOLDER / script, *ARGUMENTS[script], cwd=folder))

    return run


def test_every_script_is_tested():
    assert sorted(ARGUMENTS) == SCRIPTS


@pytest.mark.parametrize(
    "script",
    [pytest.param(script, marks=() if script == QUICK else pytest.mark.slow) for script in SCRIPTS],
)
def test_it_identifies_all_ten_parameters(ran, script):
    run = ran(script)
    assert run.returncode == 0, run.stderr
    assert "determine 10 of 10 parameters" in run.stdout
    assert "Traceback" not in run.stderr


@pytest.mark.slow
def test_the_paper_case_prints_estimate_deviation_and_truth(ran):
    rows = re.findall(r"^(\S+) \[\S+\] +(\S+) +(\S+) +(\S+)$", ran("paper_case.py").stdout, re.M)
    assert len(rows) == 10
    for name, estimate, deviation, truth in rows:
        assert float(estimate) == pytest.approx(float(truth), abs=1e-6), name
        assert 0 < float(deviation) < 1e-6


def test_the_online_estimate_converges_to_the_tank(ran):
    """Rank 10 from the third sample on; at the end, from five decimals, the truth within 4 σ."""
    stdout = ran("online_identification.py").stdout
    rows = re.findall(r"^ +(\d+\.\d+) +(\d+) +(\S+) ", stdout, re.M)
    assert [float(time) for time, _, _ in rows] == [0.5 * k for k in range(1, 21)]
    assert [int(rank) for _, rank, _ in rows] == [6, 9] + 18 * [10]
    final = re.findall(r"^(\S+) \[\S+\] +(\S+) +(\S+) +(\S+)$", stdout, re.M)
    assert len(final) == 10
    for name, estimate, deviation, truth in final:
        assert abs(float(estimate) - float(truth)) < 4 * float(deviation), name
    assert float(final[0][1]) == pytest.approx(60.0, abs=0.1)


@pytest.mark.slow
def test_the_estimate_from_sensors_converges_to_the_target(ran):
    """σ falls from NaN to below a gram and a half; at the end the truth is within 5 σ."""
    stdout = ran("sensor_identification.py").stdout
    rows = re.findall(r"^ +(\d+\.\d+) +(\d+) +(\S+) ± (\S+) ", stdout, re.M)
    assert [float(time) for time, *_ in rows] == [0.5 + k for k in range(10)]
    counts = [int(count) for _, count, _, _ in rows]
    assert counts == sorted(set(counts))
    sigmas = [float(sigma) for *_, sigma in rows]
    assert np.isnan(sigmas[0])
    assert sigmas[-1] < 0.0015 < sigmas[2]
    final = re.findall(r"^(\S+) \[\S+\] +(\S+) +(\S+) +(\S+)$", stdout, re.M)
    assert len(final) == 10
    for name, estimate, deviation, truth in final:
        assert abs(float(estimate) - float(truth)) < 5 * float(deviation) + 1e-5, name


@pytest.mark.slow
def test_the_estimate_makes_the_tracking_error_vanish(ran, folder):
    """1000 times smaller with exact data, 20 times with sensors; without an estimate it stays."""
    stdout = ran("adaptive_control.py").stdout
    before, after = re.search(r"^initial model, always +(\S+) +(\S+)$", stdout, re.M).groups()
    assert float(after) >= 0.5 * float(before) > 0.1
    for name, least in (("exact state", 1e3), ("flight sensors", 20.0)):
        row = re.search(rf"^{name}, used from (\S+) s +(\S+) +(\S+) +(\S+)$", stdout, re.M)
        start, before, after, ratio = map(float, row.groups())
        assert 1.0 < start < 5.0
        assert before > 0.1
        assert before / after == pytest.approx(ratio, rel=0.1)
        assert ratio > least
    picture = matplotlib.image.imread(folder / "errors.png")
    assert picture.std() > 0.05


@pytest.mark.slow
def test_planned_motions_reach_the_asked_precision(ran, folder):
    """With the second motion; the estimate makes the transfer ten times more exact at least."""
    stdout = ran("plan_identify_replan.py").stdout
    found = re.findall(r"^motion (\d): planned in \S+ s, worst σ (\S+) %$", stdout, re.M)
    sigmas = [float(sigma) for _, sigma in found]
    assert len(sigmas) == 2
    assert sigmas[0] > 0.15 >= sigmas[1]
    error = float(re.search(r"^largest error: (\S+) % of scale$", stdout, re.M)[1])
    assert error < 4 * sigmas[1]
    before, after = map(float, re.findall(r"estimate: (\S+) rad$", stdout, re.M))
    assert before > 10 * after
    assert matplotlib.image.imread(folder / "loop.png").std() > 0.05


@pytest.mark.slow
def test_the_sample_log_tells_the_bag_that_it_was_made_with(ran):
    stdout = ran("own_spacecraft.py").stdout
    mass = float(re.search(r"^m = (\S+) kg", stdout, re.M)[1])
    together = float(re.search(r"^together (\S+) kg", stdout, re.M)[1])
    assert mass == pytest.approx(8.5, abs=0.05)
    assert together - mass == pytest.approx(10.49, abs=0.01)


@pytest.mark.slow
def test_the_recording_is_one_self_contained_file(ran, folder):
    """Whoever gets it needs no network, and it is small enough to send."""
    ran("meshcat_view.py")
    path = folder / "view.html"
    text = path.read_text(encoding="utf-8")
    assert path.stat().st_size < 10e6
    assert re.search(r"""<(?:script|img|link|iframe)[^>]*=\s*["']?https?://""", text) is None
    assert 'src="http' not in text
    assert "<html" in text
    recorded = map(b64decode, re.findall(r"base64,([A-Za-z0-9+/=]{100,})", text))
    commands = b"".join(recorded)
    assert b"captured_target" in commands
    assert b"set_animation" in commands
