"""The scripts in diagrams/ run from anywhere, and fail in one line."""

import importlib
import os
import re
import signal
import subprocess
import sys
import time
from functools import cache

import pytest
from processes import HUNG, ROOT, finish, start

FOLDER = ROOT / "diagrams"
SCRIPTS = sorted(path.name for path in FOLDER.glob("*.py"))
ARGUMENTS = {
    "own_spacecraft.py": [],
    "live.py": [],
    "lcm.py": [],
    "adaptive_control.py": ["--figure", "errors.html"],
    "plan_identify_replan.py": ["--figure", "loop.html"],
    "passivity.py": ["--duration", "2"],
}


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
    """`identify.py` and `sensors.py` are tested as the README's, `ros2_robot.py` with the node."""
    assert sorted([*ARGUMENTS, "identify.py", "ros2_robot.py", "sensors.py"]) == SCRIPTS


@pytest.mark.slow
@pytest.mark.parametrize("script", sorted(ARGUMENTS))
def test_it_identifies_all_ten_parameters(ran, script):
    run = ran(script)
    assert run.returncode == 0, run.stderr
    assert "determine 10 of 10 parameters" in run.stdout or script == "passivity.py"
    assert "Traceback" not in run.stderr


@pytest.mark.parametrize(
    ("study", "arguments", "cause"),
    [
        ("paper", [], "--out"),
        ("techniques", ["air_bearing", "--out", "x"], "floats freely"),
        ("techniques", ["tumbling_capture", "--out", "x"], "without momentum"),
        ("techniques", ["--out", "x", "--force-sensors", "no.yaml"], "no.yaml: no such file"),
        ("techniques", ["--out", "kept"], "kept/a.txt: exists already"),
    ],
)
def test_a_study_refuses_wrong_usage_in_one_line(
    tmp_path, monkeypatch, capsys, study, arguments, cause
):
    """In this process: an interpreter for each line would import for two seconds."""
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept/a.txt").write_text("text")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["run.py", *arguments])
    with pytest.raises(SystemExit) as ended:
        importlib.import_module(f"{study}.run").main()
    assert ended.value.code == 2
    assert cause in capsys.readouterr().err.splitlines()[-1]
    assert [each.name for each in tmp_path.iterdir()] == ["kept"]


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [5.0, 20.0])
@pytest.mark.parametrize(("study", "jobs"), [("paper", []), ("techniques", ["--jobs", "2"])])
def test_an_interrupt_ends_a_study_with_one_line(tmp_path, study, jobs, seconds):
    """Also where its processes have just been started, and still import."""
    process = start(
        *(FOLDER / study / "run.py", "--out", "x", "--quiet", *jobs),
        cwd=tmp_path,
        start_new_session=True,
    )
    time.sleep(seconds)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, stderr = process.communicate(timeout=HUNG)
    assert (process.returncode, stderr) == (130, "run.py: interrupted\n")


@pytest.mark.slow
def test_the_comparison_writes_its_page_and_numbers(tmp_path):
    options = ("--fast", "--trials", "1", "--jobs", "1", "--quiet", "--out", "out")
    run = finish(start(FOLDER / "techniques/run.py", "exciting_motion", *options, cwd=tmp_path))
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")
    page = (tmp_path / "out/report.html").read_text()
    assert "python diagrams/techniques/run.py exciting_motion --trials 1" in page
    rows = (tmp_path / "out/techniques.csv").read_text().splitlines()
    [rms] = [
        row
        for row in rows
        if row.startswith('"momentum, trajectory fit",exciting') and "flight,scenario,rms" in row
    ]
    assert float(rms.rpartition(",")[2]) < 1e-3


@pytest.mark.slow
def test_the_estimate_makes_the_tracking_error_vanish(ran, folder):
    """1000 times smaller with exact data, 20 times with sensors; without an estimate it stays."""
    stdout = ran("adaptive_control.py").stdout
    before, after, _ = re.search(r"^none +(\S+) +(\S+) +(\S+)$", stdout, re.M).groups()
    assert float(after) >= 0.5 * float(before) > 0.1
    for name, least in (("exact", 1e3), ("flight", 20.0)):
        row = re.search(rf"^{name}, used from (\S+) s +(\S+) +(\S+) +(\S+)$", stdout, re.M)
        start, before, after, ratio = map(float, row.groups())
        assert 1.0 < start < 5.0
        assert before > 0.1
        assert before / after == pytest.approx(ratio, rel=0.1)
        assert ratio > least
    assert "estimate from: flight" in (folder / "errors.html").read_text()


@pytest.mark.slow
def test_parameters_come_while_the_arms_move_and_the_base_may_rest(ran, folder):
    stdout = ran("passivity.py").stdout
    errors = dict(re.findall(r"^ +(\S+) s +(\S+)$", stdout, re.M))
    assert float(errors["1.0"]) < 1e-3
    for page in ("adaptive.html", "still_base.html"):
        assert f"{page} plays the motion" in stdout
        assert (folder / page).stat().st_size > 1e5
    rotations = [float(each) for each in re.findall(r"rotates by (\S+)°", stdout)]
    assert rotations[0] > 100 * rotations[1]
    assert max(float(error) for error in re.findall(r"error (\S+)$", stdout, re.M)) < 1e-3


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
    assert "Largest tracking error of the joints" in (folder / "loop.html").read_text()


@pytest.mark.slow
def test_the_sample_log_tells_the_bag_that_it_was_made_with(ran):
    stdout = ran("own_spacecraft.py").stdout
    mass = float(re.search(r"^m = (\S+) kg", stdout, re.M)[1])
    together = float(re.search(r"^together (\S+) kg", stdout, re.M)[1])
    assert mass == pytest.approx(8.5, abs=0.05)
    assert together - mass == pytest.approx(10.49, abs=0.01)


@pytest.mark.slow
def test_the_python_of_the_page_about_logs_runs(monkeypatch):
    monkeypatch.chdir(ROOT)
    page = (ROOT / "docs/how-to/logs.md").read_text()
    [block] = re.findall(r"```python\n(.*?)```", page, re.S)
    names = {}
    exec(compile(block, "logs.md", "exec"), names)
    assert names["result"].consistent.mass == pytest.approx(8.5, abs=0.05)


ALONE = """
import importlib.metadata as metadata
import re
import runpy
import sys

names, allowed = ["drake", "numpy", "scipy"], {"cpid-drake"}
while names:  # what Drake's wheel brings is there, too
    name = names.pop()
    if name not in allowed:
        allowed.add(name)
        try:
            needs = metadata.requires(name) or []
        except metadata.PackageNotFoundError:
            continue
        names += [re.match(r"[\\w.-]+", each)[0].lower() for each in needs if "extra" not in each]
owners = metadata.packages_distributions()

class Refusing:
    def find_spec(self, name, path=None, target=None):
        owner = owners.get(name.partition(".")[0])
        if owner and not {each.lower() for each in owner} & allowed:
            raise ImportError(f"{name} is not of {sorted(allowed)}")

sys.meta_path.insert(0, Refusing())
runpy.run_path(sys.argv[1], run_name="__main__")
"""


@pytest.mark.slow
def test_the_first_diagram_needs_nothing_but_drake_numpy_and_scipy(tmp_path):
    (tmp_path / "alone.py").write_text(ALONE)
    script = tmp_path / "alone.py"
    run = finish(start(script, str(FOLDER / "identify.py"), cwd=tmp_path))
    assert run.returncode == 0, run.stderr
    assert "scene.html" in run.stdout
