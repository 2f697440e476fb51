"""Bad files: one line that names the file and the place; at the command line, exit code 2."""

import json

import pytest
from corpus import Case, cases, link, urdf, write_good
from processes import finish, start

from cpid_drake import (
    InputError,
    Spacecraft,
    identify,
    load_scenario,
    load_sensors,
    make_simulation,
    read_log,
)
from cpid_drake.files.errors import prefix_errors
from cpid_drake.identification.result_files import read_result

CASES = cases()
SLOW = ("million_rows", "directives_that_double")
READ = [
    pytest.param(case, id=str(case), marks=pytest.mark.slow if case.name in SLOW else ())
    for case in CASES
    if case.kind != "export" and case.name != "long_name"
]
COMMANDED = [
    *(
        "telemetry-text",
        "telemetry-line_end_in_name",
        "telemetry-long_name",
        "model-mass_comma",
        "scenario-tab",
    ),
    *("scenario-joint_misspelt_in_it", "sensors-sigma_unit_in_it", "result-key_twice"),
    *("export-unknown", "export-not_consistent"),
]
"""Cases for the command line: one of each kind, or of what only a command refuses."""


def craft(model: str = "arm.urdf") -> Spacecraft:
    return Spacecraft(model, base="bus", capture_frame="hand")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder, the current one, with a good model and a good log."""
    monkeypatch.chdir(tmp_path)
    write_good(tmp_path)
    return tmp_path


def read(kind: str, name: str) -> None:
    """Read a file of this kind, and use what it holds."""
    if kind == "telemetry":
        identify(craft(), read_log(name))
    elif kind == "model":
        craft(name)
    elif kind == "scenario":
        scenario = load_scenario(name)
        with prefix_errors(name):
            make_simulation(scenario)
    else:
        {"sensors": load_sensors, "result": read_result}[kind](name)


@pytest.mark.parametrize("case", READ)
def test_a_bad_file_is_refused_with_one_line_that_names_the_place(case: Case, folder):
    name = case.make(folder)
    before = sorted(folder.iterdir())
    with pytest.raises(InputError) as caught:
        read(case.kind, name)
    message = str(caught.value)
    assert message == " ".join(message.split())
    assert len(message) < 600 + len(name)
    for phrase in case.phrases:
        assert phrase in message
    assert sorted(folder.iterdir()) == before  # no payload has run


def command(kind: str, name: str) -> list[str]:
    """Return the arguments with which `cpid` reads a file of this kind."""
    craft = ["--base", "bus", "--capture-frame", "hand"]
    export = ["export", "--format", "urdf", "--out", "out.urdf", "--", name]
    return {
        "telemetry": ["identify", "--model", "arm.urdf", *craft, "--", name],
        "sensors": ["identify", "log.csv", "--model", "arm.urdf", *craft, "--sensors", name],
        "model": ["identify", "log.csv", "--model", name, *craft],
        "scenario": ["simulate", "--check", "--", name],
        "result": export,
        "export": export,
    }[kind]


@pytest.mark.parametrize("case", [c for c in CASES if str(c) in COMMANDED], ids=str)
def test_a_command_ends_in_one_line_and_writes_nothing(case: Case, folder, run_cpid):
    name = case.make(folder)
    before = sorted(folder.iterdir())
    code, stdout, stderr = run_cpid(*command(case.kind, name))
    assert (code, stdout) == (2, ""), stderr
    assert stderr.startswith("cpid: error: ")
    assert stderr.endswith("\n")
    assert stderr.count("\n") == 1
    for phrase in case.phrases:
        assert phrase in stderr
    assert sorted(folder.iterdir()) == before


# -- what only looks odd --------------------------------------------------------------------------


def test_empty_cells_and_one_sample_leave_something_open(folder, run_cpid):
    """Exit code 3: the file is all right, and what it says is not enough."""
    lines = (folder / "log.csv").read_text().splitlines()
    (folder / "t.csv").write_text("\n".join([lines[0], lines[60], "99" + "," * 19]))
    code, stdout, _ = run_cpid(*command("telemetry", "t.csv"))
    assert code == 3
    assert "1 sample" in stdout


def test_nothing_is_fetched_or_read_for_meshes(folder):
    uris = ("http://127.0.0.1:9/a.obj", "file:///dev/zero", "package://elsewhere/a.obj")
    shapes = "".join(
        f'<{kind}><geometry><mesh filename="{uri}"/></geometry></{kind}>'
        for kind in ("visual", "collision")
        for uri in uris
    )
    (folder / "m.urdf").write_text(urdf(link("hand", inner=shapes)))
    assert len(craft("m.urdf").joint_names) == 3


# -- in processes of their own --------------------------------------------------------------------

DANGEROUS = (
    *("telemetry-device", "telemetry-fifo", "telemetry-long_line"),
    *("model-directives_of_themselves", "model-sdf_of_itself"),
    *("model-mjcf_of_itself", "model-billion_laughs", "model-deep"),
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


@pytest.mark.slow
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
