"""The commands of the pages, one after the other: each runs, and prints what its page shows."""

import os
import re
import shutil
import subprocess
import sys

import pytest
from processes import ROOT

PAGES = ("how-to/logs.md", "how-to/columns.md", "how-to/hardware.md", "reference/scenarios.md")
BLOCK = re.compile(r"^( *)```(sh)?\n(.*?)^ *```$", re.M | re.S)


def blocks(page: str) -> list[tuple[str, str]]:
    """Return each block of commands of a page with the output that follows it, or nothing."""
    found = []
    for indent, kind, text in BLOCK.findall((ROOT / "docs" / page).read_text(encoding="utf-8")):
        text = "\n".join(line.removeprefix(indent) for line in text.splitlines())
        if kind:
            found.append([text, ""])
        elif found and not found[-1][1]:
            found[-1][1] = text
    return [tuple(each) for each in found]


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page_run_and_print_what_it_shows(page, tmp_path):
    shutil.copytree(ROOT / "models", tmp_path / "models")
    (tmp_path / "diagrams").symlink_to(ROOT / "diagrams")
    program = tmp_path / "cpid"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m cpid_drake "$@"\n')
    program.chmod(0o755)
    paths = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    search = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1", "PATH": search}
    for commands, shown in blocks(page):
        ran = ["bash", "-c", commands]
        done = subprocess.run(
            ran, capture_output=True, text=True, cwd=tmp_path, env=environment, check=False
        )
        assert done.returncode in (0, 3, 4), (commands, done.stderr)
        printed = {line.rstrip() for line in (done.stdout + done.stderr).splitlines()}
        missing = [
            line for line in shown.splitlines() if line.rstrip() not in printed | {"...", ""}
        ]
        assert not missing, (commands, missing)
