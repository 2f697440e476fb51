"""The README: its Diagram is diagrams/identify.py, its commands run and print what it shows."""

import difflib
import json
import os
import re
import runpy
import shlex
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from processes import ROOT

import cpid_drake
from cpid_drake.commands.main import app
from cpid_drake.files.digits import with_half_width
from cpid_drake.logs.formats import FORMATS, table_of

README = (ROOT / "README.md").read_text()
READMES = ("*.md", "cpid_drake/README.md", "diagrams/README.md", "models/**/README.md")
DIAGRAMS = ROOT / "diagrams"
PAGES = sorted(path for glob in (*READMES, "docs/**/*.md") for path in ROOT.glob(glob))


def test_the_links_of_the_pages_lead_somewhere():
    links = [
        (page, link)
        for page in PAGES
        for link in re.findall(r"(?<!`)\[[^]]*\]\((?!https?:|#)([^)#]+)", page.read_text())
    ]
    assert len(links) > 100
    dead = [(page, link) for page, link in links if not (page.parent / link).exists()]
    assert [(str(page.relative_to(ROOT)), link) for page, link in dead] == []


def test_the_readme_is_short():
    lines = README.splitlines()
    assert len(lines) <= 140
    assert [line for line in lines if len(line) > 110] == []


def test_every_command_and_option_of_the_pages_exists():
    """Of all lines with `cpid` in the pages' blocks for a shell."""
    found = 0
    for page in PAGES:
        for block in re.findall(r"```sh\n(.*?)```", page.read_text(), re.S):
            for line in re.findall(r"^ *cpid (.+)$", block.replace("\\\n", " "), re.M):
                words = shlex.split(line, comments=True)
                _, [*_, command], rest = app.parse_commands(words)
                known = {
                    name for each in command.assemble_argument_collection() for name in each.names
                }
                given = {word.partition("=")[0] for word in rest if word.startswith("--")}
                assert given <= known, (page.name, line)
                found += 1
    assert found > 20


@pytest.fixture
def ran(tmp_path, monkeypatch):
    """Return a function (script) -> its names after a run, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["script"])
    return lambda script: runpy.run_path(str(DIAGRAMS / script))


def test_a_log_comes_first_and_early():
    assert (
        README.splitlines()[:40].index(
            "cpid identify models/telemetry/free_flyer.csv --sensors "
            "models/telemetry/free_flyer_sensors.yaml \\"
        )
        > 0
    )


def test_the_lines_of_the_diagram_are_the_script_and_identify_the_target(ran, tmp_path, capsys):
    """Exactly, from the third sample on; the controller uses it, and a page keeps the motion."""
    [diagram] = re.findall(r"```python\n(.*?)```", README, re.S)
    script = iter((DIAGRAMS / "identify.py").read_text().splitlines())
    for line in diagram.splitlines():
        assert any(line == other.strip() for other in script), line  # in this order
    names = ran("identify.py")
    found, truth = names["found"], names["tank"].to_vector()
    np.testing.assert_allclose(found.parameters, truth, rtol=0, atol=1e-6)
    assert found.rows == "eq18"
    assert found.passed
    context = names["simulator"].get_context()
    assert names["state_log"].FindLog(context).sample_times()[-1] == 10.0
    diagram = names["simulator"].get_system()
    controller = diagram.GetSubsystemByName("joint_controller")
    model = controller.GetOutputPort("model_target")
    used = model.Eval(controller.GetMyContextFromRoot(context))
    np.testing.assert_allclose(used, truth, rtol=0, atol=1e-6)
    lines = capsys.readouterr().out.splitlines()
    [printed] = re.findall(r"```\n(truth .*?)```", README, re.S)
    assert {line.rstrip() for line in lines} >= set(printed.splitlines())
    rows = [line.split() for line in lines]
    _, shown, first, *_ = rows
    assert shown == ["truth", *(f"{value:.4f}" for value in truth)]
    assert rows[4] == ["3", "s", *shown[1:]]
    assert first == ["1", "s", *shown[1:]]
    assert rows[-1][0] == "scene.html"
    assert "momentum P of the target" in (tmp_path / "scene.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_real_sensors_replace_the_line_of_the_identifier(ran):
    """The scripts differ in these lines alone; each parameter is within 4 σ, the mass to 0.05 %."""
    _, lines = re.findall(r"```py\n(.*?)```", README, re.S)
    exact, sensed = ((DIAGRAMS / n).read_text() for n in ("identify.py", "sensors.py"))
    exact, sensed = (text[text.index("import sys") :].splitlines() for text in (exact, sensed))
    changes = list(difflib.ndiff(exact, sensed))
    assert [line[2:] for line in changes if line.startswith("+ ")] == lines.splitlines()
    [gone] = [line for line in changes if line.startswith("- ")]
    assert gone[2:].startswith("identifier = cpid.MomentumIdentifier")
    names = ran("sensors.py")
    found, truth = names["found"], names["tank"].to_vector()
    sigma = np.sqrt(np.diag(found.covariance))
    assert (np.abs(found.parameters - truth) < 4 * sigma).all()
    assert sigma[0] < 0.03
    assert found.passed
    assert f"| {found.parameters[0]:.3f} ± {1.96 * sigma[0]:.3f} kg | 60 kg |" in README


def test_a_robots_own_loop_finds_what_the_log_has(monkeypatch):
    lines, _ = re.findall(r"```py\n(.*?)```", README, re.S)
    assert len(lines.splitlines()) <= 8
    monkeypatch.chdir(ROOT)
    names = {"cpid": cpid_drake}
    exec(lines, names)
    found = names["identifier"].estimate()
    assert found.passed
    assert sum(found.rejected.values()) == 0
    assert abs(found.parameters[0] - 8.5) < 3 * found.covariance[0, 0] ** 0.5


@pytest.mark.slow
def test_all_commands_run_one_after_the_other(tmp_path):
    """In a folder with the models, as they stand; what one writes the next may read."""
    for folder in ("models", "diagrams"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    programs = {"cpid": ["-m", "cpid_drake"], "python": []}
    commands = re.findall(r"^\| .+ \| `((?:cpid|python) .+)` \|$", README, re.M)
    assert len(commands) == 10
    commands += re.findall(r"^cpid .+$", README.replace("\\\n", " "), re.M)
    assert len(commands) == 11
    for command in commands:
        program, *words = shlex.split(command)
        arguments = [sys.executable, *programs[program], *words]
        paths = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
        environment = os.environ | {"PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"}
        done = subprocess.run(
            arguments, capture_output=True, text=True, cwd=tmp_path, env=environment, check=False
        )
        assert done.returncode == 0, (command, done.stderr)


def test_the_command_prints_what_the_readme_shows(tmp_path):
    block, shown = re.search(r"```sh\n(cpid .*?)```\n\n```\n(.*?)```", README, re.S).groups()
    _, *arguments = shlex.split(block.replace("\\\n", " "))
    arguments = [str(ROOT / each) if each.startswith("models/") else each for each in arguments]
    arguments = (
        arguments[: arguments.index("--report")] + arguments[arguments.index("--report") + 2 :]
    )
    command = [sys.executable, "-m", "cpid_drake", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    assert set(shown.splitlines()) <= set(done.stdout.splitlines())
    assert f"| {mass_of(tmp_path / 'bag.json')} kg | 8.5 kg |" in README


@pytest.mark.parametrize(
    ("label", "without"),
    [
        ("attitude, position and joints", ["gyro"]),
        ("attitude, rates and joints", ["position"]),
        ("attitude and joints alone", ["gyro", "position"]),
    ],
)
def test_the_table_says_what_fewer_sensors_give(label, without):
    spacecraft = cpid_drake.load_spacecraft("free_flyer_payload").make()
    log = cpid_drake.read_log(ROOT / "models/telemetry/free_flyer.csv")
    suite = cpid_drake.load_sensors(ROOT / "models/telemetry/free_flyer_sensors.yaml")
    found = cpid_drake.identify(spacecraft, log, sensors=replace(suite, **dict.fromkeys(without)))
    assert found.passed
    mass = with_half_width(found.parameters[0], 1.96 * found.covariance[0, 0] ** 0.5)
    assert f"| its {label} | {mass} kg | 8.5 kg |" in README


def test_the_format_of_the_contributors_page_is_read(tmp_path, monkeypatch):
    [code] = re.findall(r"```python\n(.*?)```", (ROOT / "CONTRIBUTING.md").read_text(), re.S)
    monkeypatch.setattr("cpid_drake.logs.formats.FORMATS", dict(FORMATS))
    exec(code, {})
    sample = cpid_drake.read_log(ROOT / "models/telemetry/free_flyer.csv")
    names, values = table_of(sample)
    (tmp_path / "log.json").write_text(json.dumps(dict(zip(names, values.T.tolist()))))
    found = cpid_drake.read_log(tmp_path / "log.json")
    np.testing.assert_array_equal(found.gyro.value, sample.gyro.value)
    assert len(found.gyro) > 0


def mass_of(result):
    """Return the mass of a result as the table of accuracies shows it."""
    found = cpid_drake.read_result(result)
    return with_half_width(found.parameters[0], 1.96 * found.covariance[0, 0] ** 0.5)


@pytest.mark.slow
def test_the_table_says_what_uncalibrated_hardware_gives(tmp_path):
    command = ["identify", str(ROOT / "models/telemetry/free_flyer.csv"), "--sensors", "testbed"]
    command += ["--spacecraft", "free_flyer_payload", "--json", str(tmp_path / "bag.json")]
    subprocess.run([sys.executable, "-m", "cpid_drake", *command], check=True)
    assert f"| {mass_of(tmp_path / 'bag.json')} kg | 8.5 kg |" in README
