"""Bad files at the command line: one line that names the file and the place, and exit code 2."""

import json
import re
import sys

import pytest
from corpus import Case, cases, link, urdf, write_good
from processes import finish, start

from cpid_drake.commands.main import main

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


LARGE = ("million_rows", "npz_bomb", "long_line", "long_header")
QUICK = [case for case in CASES if case.kind == "telemetry" and case.name not in LARGE]


@pytest.mark.parametrize("case", QUICK, ids=str)
def test_a_check_of_bad_telemetry_ends_the_same_way(case: Case, cpid, tmp_path):
    """What `check` finds wrong it lists on stdout; the error counts it."""
    name = case.make(tmp_path)
    craft = ["--spacecraft", "arm.urdf", "--base", "bus", "--capture-frame", "hand"]
    code, stdout, stderr = cpid("telemetry", "check", *craft, "--", name)
    assert code == 2
    assert stderr.startswith("cpid: error: ")
    assert stderr.count("\n") == 1
    said = stdout + stderr
    for phrase in case.phrases:
        assert phrase.removeprefix("t.csv: ") in said


def test_names_of_cases_are_unique():
    names = [str(case) for case in CASES]
    assert len(set(names)) == len(names) >= 60


# -- what only looks odd --------------------------------------------------------------------------


ODD = {
    "nothing": lambda text: text,
    "windows_line_ends": lambda text: text.replace("\n", "\r\n"),
    "byte_order_mark": lambda text: "\ufeff" + text,
    "quotes": lambda text: re.sub(r"[^,\n]+", r'"\g<0>"', text),
    "blank_lines_and_comments": lambda text: "# a log\n" + text.replace("\n", "\n\n# it's 5 °C\n"),
    "blanks_around_cells": lambda text: text.replace(",", " ,  "),
    "another_column": lambda text: text.replace("\n", ",fine\n").replace("fine", "note", 1),
    "columns_in_another_order": lambda text: "".join(
        ",".join(reversed(line.split(","))) + "\n" for line in text.splitlines()
    ),
    "no_last_line_end": lambda text: text.rstrip("\n"),
}


def estimate(output: str) -> str:
    """Return the table of parameters in what `cpid identify` prints."""
    return output[output.index("estimate") :]


@pytest.mark.parametrize("name", ODD)
def test_a_log_that_only_looks_odd_says_the_same(name, cpid, tmp_path):
    code, plain, stderr = cpid(*command("telemetry", "log.csv"))
    assert (code, stderr) == (0, "")
    (tmp_path / "odd.csv").write_bytes(ODD[name]((tmp_path / "log.csv").read_text()).encode())
    code, odd, stderr = cpid(*command("telemetry", "odd.csv"))
    assert (code, stderr) == (
        0,
        "note: ignored columns: note\n" * (name == "another_column"),
    )
    assert estimate(odd) == estimate(plain)


def test_empty_cells_and_one_sample_leave_something_open(cpid, tmp_path):
    """Exit code 3: the file is all right, and what it says is not enough."""
    lines = (tmp_path / "log.csv").read_text().splitlines()
    (tmp_path / "t.csv").write_text("\n".join([lines[0], lines[60], "99" + "," * 19]))
    code, stdout, _ = cpid(*command("telemetry", "t.csv"))
    assert code == 3
    assert "1 sample" in stdout


def test_nothing_is_fetched_or_read_for_meshes(cpid, tmp_path):
    uris = ("http://127.0.0.1:9/a.obj", "file:///dev/zero", "package://elsewhere/a.obj")
    shapes = "".join(
        f'<{kind}><geometry><mesh filename="{uri}"/></geometry></{kind}>'
        for kind in ("visual", "collision")
        for uri in uris
    )
    (tmp_path / "m.urdf").write_text(urdf(link("hand", inner=shapes)))
    code, _, _ = cpid(*command("model", "m.urdf"))
    assert code == 0


# -- in processes of their own --------------------------------------------------------------------

DANGEROUS = (
    *("telemetry-device", "telemetry-fifo", "telemetry-npz_bomb", "telemetry-npz_claims_much"),
    *("telemetry-long_line", "telemetry-link_to_itself", "scenario-billion_laughs"),
    *("model-directives_of_themselves", "model-directives_billion_laughs", "model-sdf_of_itself"),
    *("model-mjcf_of_itself", "model-billion_laughs_sdf", "model-deep", "result-deep"),
)
LIMITED = """
import json, os, resource, sys
resource.setrlimit(resource.RLIMIT_AS, (3 * 2**30,) * 2)
import pydrake.multibody.parsing, scipy.optimize  # once for all of them
from cpid_drake.commands.main import main
for arguments in json.load(sys.stdin):
    child = os.fork()
    if not child:
        resource.setrlimit(resource.RLIMIT_CPU, (10, 10))
        sys.argv = ["cpid", *arguments]
        main()
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


def test_the_dangerous_ones_end_with_little_memory_and_time(tmp_path):
    """As the command would end: a crash, or a wait for what never comes, is seen from outside."""
    by_name = {str(case): case for case in CASES}
    commands = []
    for name in DANGEROUS:
        case, folder = by_name[name], tmp_path / name
        folder.mkdir()
        write_good(folder)
        names = {word: str(folder / word) for word in ("arm.urdf", "log.csv", case.make(folder))}
        arguments = command(case.kind, list(names)[-1])
        commands.append([names.get(word, word) for word in arguments])
    run = finish(start("-c", LIMITED, cwd=tmp_path), json.dumps(commands))
    assert run.returncode == 0, run.stderr
    assert dict(zip(DANGEROUS, run.stdout.split())) == dict.fromkeys(DANGEROUS, "2"), run.stderr
    assert run.stderr.count("\n") == len(DANGEROUS)
