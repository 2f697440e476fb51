"""`cpid validate`: the right target predicts another log, and a wrong one does not."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flyer_cases import FREE_FLYER, SAMPLE

from cpid_drake import read_log, write_log
from cpid_drake.identification.result_files import read_result, write_result

LOGS = ("result.json", "second.csv")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("validate")


@pytest.fixture
def cpid(run_cpid, monkeypatch, folder):
    """Return a function that runs `cpid` in a folder with a result and another log."""
    monkeypatch.chdir(folder)
    if not Path("result.json").exists():
        log = read_log(SAMPLE)
        write_log("first.csv", log.between(0.0, 4.999))
        write_log("second.csv", log.between(4.999, 20.0))
        run_cpid(
            "identify",
            "first.csv",
            *FREE_FLYER,
            "--sensors",
            "testbed",
            "--json",
            "result.json",
            "--quiet",
        )
    return run_cpid


@pytest.mark.slow
def test_the_right_target_predicts_another_log(cpid):
    known = ("result.json", "second.csv", "--momentum", "zero", "--json", "v.json")
    code, stdout, stderr = cpid("validate", *known)
    assert (code, stderr) == (0, "")
    assert stdout.startswith("valid: the log agrees with this target")
    [heavier] = re.findall(r"A target (\S+) % heavier would be noticed", stdout)
    assert 1 < float(heavier) < 15
    found = json.loads(Path("v.json").read_text())
    assert found["is_valid"]
    assert found["probability"] > 0.1
    assert found["momentum"] == "zero"
    errors = {error["sensor"]: error for error in found["errors"]}
    assert errors["attitude"]["unit"] == "deg"
    assert all(error["in_sigma"] < 2 for error in errors.values())
    assert cpid("validate", *known, "--quiet", "--force")[:2] == (0, "")


def test_a_mass_wrong_by_forty_sigma_is_noticed(cpid, refusal):
    result = read_result("result.json")
    heavier = result.parameters + 40 * np.sqrt(result.covariance[0, 0]) * np.eye(10)[0]
    wrong = replace(result, parameters=heavier, nearest=None)
    write_result("wrong.json", wrong)
    assert "set `combinations` to null" in refusal("validate", "wrong.json", "second.csv")
    write_result("wrong.json", replace(wrong, combinations=None))
    code, stdout, _ = cpid("validate", "wrong.json", "second.csv", "--json", "w.json")
    assert code == 4
    assert stdout.startswith("not valid: the log's own estimate differs")
    found = json.loads(Path("w.json").read_text())
    assert not found["is_valid"]
    assert found["probability"] < 1e-6


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("result.json", "first.csv"), "the result was identified from this log"),
        ((*LOGS, "--threshold", "0"), "--threshold"),
        ((*LOGS, "--beginning", "1.5"), "the beginning must be a share between 0 and 1"),
        ((*LOGS, "--to", "5.5"), "too short"),
        ((*LOGS, "--json", "second.csv"), "is the input second.csv"),
    ],
)
def test_what_cannot_be_is_one_line(refusal, arguments, words):
    assert words in refusal("validate", *arguments)
