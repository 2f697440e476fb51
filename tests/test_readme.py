"""The README: its Diagram is diagrams/identify.py, its command prints what it shows."""

import re
import runpy
import shlex
import subprocess
import sys

import numpy as np
import pytest
import typer
from processes import ROOT

from cpid_drake.commands.main import app

README = (ROOT / "README.md").read_text()
READMES = ("README.md", "cpid_drake/README.md", "diagrams/README.md", "models/**/README.md")
PAGES = sorted(path for glob in (*READMES, "docs/*.md") for path in ROOT.glob(glob))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_is_short_and_its_links_lead_somewhere(page):
    text = page.read_text()
    assert len(text.splitlines()) <= 130
    for link in re.findall(r"(?<!`)\[[^]]*\]\((?!https?:|#)([^)#]+)", text):
        assert (page.parent / link).exists(), link


def test_every_command_and_option_of_the_pages_exists():
    """Of all lines with `cpid` in the pages' blocks for a shell."""
    group, found = typer.main.get_command(app), 0
    for page in PAGES:
        for block in re.findall(r"```sh\n(.*?)```", page.read_text(), re.S):
            for line in re.findall(r"^ *\.venv/bin/cpid (.+)$", block.replace("\\\n", " "), re.M):
                words = shlex.split(line, comments=True)
                _, command, rest = group.resolve_command(None, words)
                while hasattr(command, "resolve_command"):
                    _, command, rest = command.resolve_command(None, rest)
                known = {name for parameter in command.params for name in parameter.opts}
                given = {word.partition("=")[0] for word in rest if word.startswith("--")}
                assert given <= known, (page.name, line)
                found += 1
    assert found > 20


def test_the_diagram_is_the_script_and_identifies_the_target():
    """Each parameter within 4 σ, and the mass to 0.01 kg (1 σ)."""
    script = ROOT / "diagrams/identify.py"
    [diagram] = re.findall(r"```python\n(.*?)```", README, re.S)
    assert script.read_text().endswith(diagram)
    names = runpy.run_path(str(script))
    found, truth = names["found"], names["tank"].to_vector()
    sigma = np.sqrt(np.diag(found.covariance))
    assert (np.abs(found.parameters - truth) < 4 * sigma).all()
    assert sigma[0] < 0.01
    assert names["state_log"].FindLog(names["root_context"]).sample_times()[-1] == 10.0


def test_the_command_prints_what_the_readme_shows(tmp_path):
    block, shown = re.search(
        r"```sh\n(\.venv/bin/cpid .*?)```\n\n```\n(.*?)```", README, re.S
    ).groups()
    _, *arguments = shlex.split(block.replace("\\\n", " "))
    arguments = [str(ROOT / each) if each.startswith("models/") else each for each in arguments]
    arguments = (
        arguments[: arguments.index("--report")] + arguments[arguments.index("--report") + 2 :]
    )
    command = [sys.executable, "-m", "cpid_drake", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    assert set(shown.splitlines()) <= set(done.stdout.splitlines())
    assert (tmp_path / "bag.json").is_file()
