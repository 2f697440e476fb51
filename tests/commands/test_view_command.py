"""`cpid view`: a page of a scenario, and what is wrong in one line."""

import re

import pytest

from cpid_drake.files.resources import models_directory


@pytest.fixture
def scenario(tmp_path):
    text = (models_directory() / "scenarios" / "free_flyer_payload.yaml").read_text()
    text = text.replace("simulation:\n  duration: 10.0", "simulation:\n  duration: 1.5")
    path = tmp_path / "short.yaml"
    path.write_text(text.replace("accuracy: 3.0e-11", "accuracy: 1.0e-8"))
    return path


def test_a_scenario_as_a_page(cpid, scenario, tmp_path):
    code, stdout, stderr = cpid("view", scenario, "--out", "view.html")
    assert code == 0
    assert re.search(r"from 6 samples\nm 8\.5000 kg .*\n +true 8\.5000\n", stdout)
    assert re.fullmatch(r"view\.html, \d\.\d MB\n", stderr)
    page = (tmp_path / "view.html").read_text(encoding="utf-8")
    assert "<h1>short</h1>" in page
    assert len(page) < 10e6


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["nothing", "--out", "a.html"], "no shipped scenario 'nothing'"),
        (["paper", "--out", "."], "is a folder"),
        (["paper", "--rate", "0"], "--rate"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(arguments, problem, tmp_path, refusal):
    assert problem in refusal("view", *arguments)
    assert not (tmp_path / "a.html").exists()
