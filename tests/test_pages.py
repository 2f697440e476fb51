"""The pages' commands run as they stand, one after the other, and print what the pages show.

A block without a language shows what the block before it prints; `...` stands for any lines.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from processes import HUNG, ROOT

PAGES = [
    *("how-to/columns", "how-to/hardware", "how-to/live", "how-to/logs", "how-to/plan"),
    *("how-to/vendor-arm", "reference/scenarios"),
]
PROGRAMS = {"cpid": "-m cpid_drake", "python": ""}
BLOCK = re.compile(r"^( *)```(\w*)\n(.*?)^ *```$(?:\n+^ *```\n(.*?)^ *```$)?", re.S | re.M)


def blocks(page: str) -> list[tuple[str, str, str | None]]:
    """Return language, text and shown output of each block of a page."""
    text = (ROOT / f"docs/{page}.md").read_text(encoding="utf-8")
    found = []
    for match in BLOCK.finditer(text):
        indent, language, block, shown = match.groups()
        found.append((language, re.sub(f"^{indent}", "", block, flags=re.M), shown))
    return found


def missing(shown: str, printed: str) -> str | None:
    """Return the first part between `...` that the output does not have after the parts before."""
    rest = "\n".join(line.rstrip() for line in printed.splitlines())
    for part in re.split(r"^ *\.\.\.$", shown, flags=re.M):
        wanted = "\n".join(line.rstrip() for line in part.strip("\n").splitlines())
        if wanted not in rest:
            return wanted
        rest = rest[rest.index(wanted) + len(wanted) :]
    return None


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Return a folder with the models, in which shells find `cpid` and this Python."""
    for name in ("models", "diagrams"):
        shutil.copytree(ROOT / name, tmp_path / name)
    (tmp_path / "bin").mkdir()
    for name, arguments in PROGRAMS.items():
        program = tmp_path / "bin" / name
        program.write_text(f'#!/bin/sh\nexec {sys.executable} {arguments} "$@"\n')
        program.chmod(0o755)
    paths = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    monkeypatch.setenv("PYTHONPATH", paths)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page_print_what_it_shows(page, folder):
    for language, text, shown in blocks(page):
        if language not in ("sh", "python"):
            continue
        command = ["bash", "-e", "-c", text] if language == "sh" else [sys.executable, "-c", text]
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=HUNG, check=False, cwd=folder
        )
        assert done.returncode in (0, 3), (text, done.stdout, done.stderr)
        if shown is not None:
            assert missing(shown, done.stdout) is None, (text, done.stdout)
