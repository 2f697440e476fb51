"""`cpid view`: a page of a scenario or of a log, and what is wrong in one line."""

import re
import sys

import pytest

from cpid_drake.commands.main import main
from cpid_drake.resources import models_directory

LOG = models_directory() / "telemetry" / "free_flyer.csv"
CRAFT = (
    *("--spacecraft", "package://cpid_drake_models/free_flyer/free_flyer.urdf"),
    *("--base", "body", "--capture-frame", "capture_point"),
)


def view(*arguments) -> int:
    """Run `cpid view` and return its exit code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["cpid", "view", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
    return ended.value.code


@pytest.fixture
def scenario(tmp_path):
    text = (models_directory() / "scenarios" / "free_flyer_payload.yaml").read_text()
    text = text.replace("simulation:\n  duration: 10.0", "simulation:\n  duration: 1.5")
    path = tmp_path / "short.yaml"
    path.write_text(text.replace("accuracy: 3.0e-11", "accuracy: 1.0e-8"))
    return path


def test_a_scenario_as_a_page(scenario, tmp_path, capsys):
    assert view(scenario, "--html", tmp_path / "view.html") == 0
    captured = capsys.readouterr()
    assert re.search(r"from 6 samples\n +m 8\.500 kg .*\n +true 8\.500\n", captured.out)
    assert re.fullmatch(r"\S+view\.html, \d\.\d MB\n", captured.err)
    page = (tmp_path / "view.html").read_text(encoding="utf-8")
    assert "<h1>short</h1>" in page
    assert len(page) < 10e6


@pytest.mark.slow
def test_a_log_as_a_page(tmp_path, capsys):
    """Of the first three seconds: the estimate evolves, and a name with < in it is text."""
    log = tmp_path / "log <1>.csv"
    head = LOG.read_text().splitlines()[:305]  # 3 s
    log.write_text("\n".join(head) + "\n")
    arguments = (*CRAFT, "--sensors", "testbed", "--html", tmp_path / "log.html", "--quiet")
    assert view(log, *arguments) == 0
    assert capsys.readouterr().out == ""
    page = (tmp_path / "log.html").read_text(encoding="utf-8")
    assert "<h1>log &lt;1&gt;.csv</h1>" in page
    shown = [float(time) for time in re.findall(r'\[(\d\.\d+), "from ', page)]
    assert len(shown) > 5  # the estimate evolves
    assert shown == sorted(shown)
    assert "as estimated" in page


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["nothing", "--html", "a.html"], "no shipped scenario 'nothing'"),
        (["paper", "--html", "nowhere/a.html"], "there is no folder nowhere"),
        (["paper", "--html", "."], "is a folder"),
        (["paper", "--rate", "0"], "--rate 0"),
        (["paper", "--html", "a.html", "--sensors", "flight"], "--sensors is for logs"),
        (["paper", "--html", "a.html", "--momentum", "zero"], "--momentum is for logs"),
        ([LOG, "--html", "a.html"], "give --spacecraft"),
        ([LOG, *CRAFT[:4], "--html", "a.html"], "give --capture-frame"),
        ([LOG, *CRAFT], "give --html"),
        ([LOG, *CRAFT, "--html", "a.html", "--live"], "not --live"),
        (["nowhere.csv", *CRAFT, "--html", "a.html"], "nowhere.csv"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(arguments, problem, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert view(*arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("cpid: error: ")
    assert captured.err.count("\n") == 1
    assert problem in captured.err
    assert not (tmp_path / "a.html").exists()
