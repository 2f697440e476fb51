"""Bad files at the command line: one line that names the file and the place, and exit code 2."""

import sys
from pathlib import Path

import pytest
from corpus import Case, cases, write_good

from cpid_drake.cli import main

CASES = cases()


def command(kind: str, name: str) -> list[str]:
    """Return the arguments with which `cpid` reads a file of this kind."""
    craft = ["--base", "bus", "--capture-frame", "hand"]
    return {
        "telemetry": ["identify", "--spacecraft", "arm.urdf", *craft, "--", name],
        "sensors": ["identify", "log.csv", "--spacecraft", "arm.urdf", *craft, "--sensors", name],
        "model": ["identify", "log.csv", "--spacecraft", name, *craft],
        "scenario": ["scenario", "check", "--", name],
        "result": ["export", "--format", "urdf", "--out", "out.urdf", "--", name],
    }[kind]


@pytest.fixture
def cpid(monkeypatch, capfd, tmp_path):
    """Return a function that runs `cpid` in a folder with a good model and a good log."""
    monkeypatch.chdir(tmp_path)
    write_good(tmp_path)

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["cpid", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, *capfd.readouterr()

    return run


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_bad_file_ends_in_one_line_that_names_the_place(case: Case, cpid, tmp_path):
    name = case.make(tmp_path)
    before = sorted(tmp_path.iterdir())
    code, stdout, stderr = cpid(*command(case.kind, name))
    assert (code, stdout) == (2, ""), stderr
    assert stderr.startswith("cpid: error: ")
    assert stderr.count("\n") == 1
    assert stderr.endswith("\n")
    assert len(stderr) < 600 + len(name)
    for phrase in case.phrases:
        assert phrase in stderr
    assert sorted(tmp_path.iterdir()) == before  # nothing was written, and no payload has run


def test_names_of_cases_are_unique():
    names = [str(case) for case in CASES]
    assert len(set(names)) == len(names) >= 60


def test_the_files_that_the_cases_spoil_are_all_right(cpid, tmp_path):
    code, _, stderr = cpid(*command("telemetry", "log.csv"))
    assert (code, stderr) == (0, "")
    assert Path("log.csv").read_text().count("\n") == 102
