"""`cpid compare`: two results agree or differ, as text, as a page and as an exit code."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flyer_cases import FREE_FLYER, SAMPLE

from cpid_drake import read_log, read_result, write_log, write_result
from cpid_drake.identification.checks import Check


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("compare")


@pytest.fixture
def cpid(run_cpid, monkeypatch, folder):
    """Return a function that runs `cpid` in a folder with results of two logs of one target."""
    monkeypatch.chdir(folder)
    if not Path("second.json").exists():
        log = read_log(SAMPLE)
        parts = {"first": log.between(0.0, 4.999), "second": log.between(4.999, 20.0)}
        for name, part in parts.items():
            write_log(f"{name}.csv", part)
            options = ("--sensors", "testbed", "--json", f"{name}.json", "--quiet")
            run_cpid("identify", f"{name}.csv", *FREE_FLYER, *options)
    return run_cpid


def test_results_of_one_target_agree(cpid):
    code, stdout, stderr = cpid("compare", "first.json", "second.json")
    assert (code, stderr) == (0, "")
    assert stdout.startswith("the results agree with one target (χ² ")
    assert "first.csv" in stdout
    assert "testbed" not in stdout  # the same for both
    assert stdout.count("●") == 20


def test_results_of_two_targets_do_not(cpid):
    second = read_result("second.json")
    heavier = replace(
        second,
        parameters=second.parameters * [1.2, *np.ones(9)],
        combinations=None,
    )
    write_result("other.json", heavier)
    arguments = ("first.json", "other.json", "--report", "page.html", "--force")
    code, stdout, _ = cpid("compare", *arguments)
    assert code == 4
    first = read_result("first.json")["m"]
    assert f"do not have the same target, most in m: {first.value:.2f} ± " in stdout
    assert f" against {heavier.parameters[0]:.2f} ± " in stdout
    page = Path("page.html").read_text(encoding="utf-8")
    assert "do not have the same target, most in m" in page
    assert first.shown_interval() in page
    assert cpid("compare", *arguments, "--quiet")[:2] == (4, "")


def test_what_is_not_decided_has_its_exit_code(cpid):
    """Of results that share no combination of the parameters, and of one that failed a check."""
    first, second = read_result("first.json"), read_result("second.json")
    for name, result, kept in (("some", first, slice(4)), ("rest", second, slice(4, 10))):
        own = result.combinations
        information = np.zeros((10, 10))
        information[kept, kept] = np.diag(np.diag(own.information)[kept])
        part = replace(result, combinations=replace(own, information=information))
        write_result(f"{name}.json", part)
    code, stdout, stderr = cpid("compare", "some.json", "rest.json")
    assert (code, stderr) == (3, "")
    assert stdout.startswith("the results determine nothing in common\n")
    write_result("failed.json", replace(second, checks=(Check("noise", "it is larger"),)))
    code, stdout, stderr = cpid("compare", "first.json", "failed.json")
    assert (code, stderr) == (3, "warning: failed.json: failed check: it is larger\n")
    assert stdout.startswith("not decided, because failed.json failed checks")


def test_the_ellipsoids_of_both_are_in_one_scene(cpid):
    arguments = ("first.json", "second.json", "--scene", "scene.html", "--force", "--quiet")
    code, stdout, stderr = cpid("compare", *arguments)
    assert (code, stdout, stderr) == (0, "", "")
    page = Path("scene.html").read_text(encoding="utf-8")
    assert '<li style="color:orange">first.json</li>' in page
    assert '<li style="color:deepskyblue">second.json</li>' in page
    assert f"m {read_result('first.json')['m'].shown()} kg" in page
    write_result("memory.json", replace(read_result("first.json"), sources=()))
    code, _, stderr = cpid("compare", "memory.json", *arguments[1:])
    assert code == 2
    assert "name a spacecraft" in stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("first.json",), "two results or more"),
        (("first.json", "first.csv"), "first.csv"),
        (("first.json", "second.json", "--report", "first.json"), "is the input"),
    ],
    ids=["one", "log", "input"],
)
def test_bad_input_is_one_line(cpid, arguments, message):
    code, stdout, stderr = cpid("compare", *arguments)
    assert (code, stdout, stderr.count("\n")) == (2, "", 1)
    assert message in stderr
