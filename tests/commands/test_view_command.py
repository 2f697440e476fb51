"""`cpid view`: a page of a scenario or of a log, and what is wrong in one line."""

import re

import pytest

from cpid_drake.resources import models_directory

LOG = models_directory() / "telemetry" / "free_flyer.csv"
CRAFT = (
    *("--spacecraft", "package://cpid_drake_models/free_flyer/free_flyer.urdf"),
    *("--base", "body", "--capture-frame", "capture_point"),
)


@pytest.fixture
def scenario(tmp_path):
    text = (models_directory() / "scenarios" / "free_flyer_payload.yaml").read_text()
    text = text.replace("simulation:\n  duration: 10.0", "simulation:\n  duration: 1.5")
    path = tmp_path / "short.yaml"
    path.write_text(text.replace("accuracy: 3.0e-11", "accuracy: 1.0e-8"))
    return path


def test_a_scenario_as_a_page(cpid, scenario, tmp_path):
    code, stdout, stderr = cpid("view", "--scenario", scenario, "--out", "view.html")
    assert code == 0
    assert re.search(r"from 6 samples\nm 8\.5000 kg .*\n +true 8\.5000\n", stdout)
    assert re.fullmatch(r"view\.html, \d\.\d MB\n", stderr)
    page = (tmp_path / "view.html").read_text(encoding="utf-8")
    assert "<h1>short</h1>" in page
    assert len(page) < 10e6


@pytest.mark.slow
def test_a_log_as_a_page(cpid, tmp_path):
    """Of the first three seconds: the estimate evolves, and a name with < in it is text."""
    log = tmp_path / "log <1>.csv"
    head = LOG.read_text().splitlines()[:305]  # 3 s
    log.write_text("\n".join(head) + "\n")
    arguments = (*CRAFT, "--sensors", "testbed", "--out", "log.html", "--quiet")
    assert cpid("view", log, *arguments)[:2] == (0, "")
    page = (tmp_path / "log.html").read_text(encoding="utf-8")
    assert "<h1>log &lt;1&gt;.csv</h1>" in page
    shown = [float(time) for time in re.findall(r'\[(\d\.\d+), "from ', page)]
    assert len(shown) > 5  # the estimate evolves
    assert shown == sorted(shown)


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--scenario", "nothing", "--out", "a.html"], "no shipped scenario 'nothing'"),
        (["--scenario", "paper", "--out", "nowhere/a.html"], "there is no folder nowhere"),
        (["--scenario", "paper", "--out", "."], "is a folder"),
        (["--scenario", "paper", "--rate", "0"], "--rate"),
        (["--scenario", "paper", "--out", "a.html", "--sensors", "flight"], "--scenario alone"),
        (["--run", ".", "--out", "a.html"], "not a run"),
        ([LOG, "--out", "a.html"], "a log needs a spacecraft"),
        ([LOG, *CRAFT[:4], "--out", "a.html"], "and --capture-frame"),
        ([LOG, *CRAFT], "give --out"),
        (["nowhere.csv", *CRAFT, "--out", "a.html"], "nowhere.csv"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(arguments, problem, tmp_path, refusal):
    assert problem in refusal("view", *arguments)
    assert not (tmp_path / "a.html").exists()
