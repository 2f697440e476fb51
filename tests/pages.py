#!/usr/bin/env python3
"""What the pages' commands print: `python tests/pages.py [how-to/logs ...]` renews what they show.

A block without a language shows what the block before it prints; `...` stands for any lines. Any
other block is a file, if the line before it begins with the file's name in backticks.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from processes import HUNG, ROOT

PAGES = (
    *("how-to/columns", "how-to/hardware", "how-to/live", "how-to/logs"),
    *("how-to/vendor-arm", "reference/scenarios"),
)
"""Pages whose output is the same on every machine; the search of a plan follows its rounding."""

ELSEWHERE = "ros2"
"""A block with this word needs ROS 2 and a second process: `tests/online/test_ros2.py` runs it."""

PROGRAMS = {"cpid": "-m cpid_drake", "python": ""}
BLOCK = re.compile(
    r"^(?:`(?P<file>[\w.]+)`[^\n]*:\n\n)?(?P<indent> *)```(?P<language>\w*)\n(?P<text>.*?)^ *```$"
    r"(?:\n+```\n(?P<shown>.*?)^```$)?",
    re.S | re.M,
)
ELLIPSIS = re.compile(r"^\.\.\.$", re.M)


@dataclass(frozen=True)
class Run:
    """A block that was run, what the page shows of its output, and where; and what it printed."""

    text: str
    shown: str | None
    place: tuple[int, int]
    code: int
    printed: str


def text_of(page: str) -> str:
    """Return the text of a page."""
    return (ROOT / f"docs/{page}.md").read_text(encoding="utf-8")


def prepare(folder: Path) -> dict[str, str]:
    """Fill a folder with what the commands need; return the environment of their shells."""
    for name in ("models", "diagrams"):
        shutil.copytree(ROOT / name, folder / name)  # a link's `..` is another folder
    (folder / "bin").mkdir()
    for name, arguments in PROGRAMS.items():
        program = folder / "bin" / name
        program.write_text(f'#!/bin/sh\nexec {sys.executable} {arguments} "$@"\n')
        program.chmod(0o755)
    paths = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    path = f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}"
    own = {"PATH": path, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1", "COLUMNS": "200"}
    return os.environ | own | {"PYTHONUNBUFFERED": "1"}


def runs(page: str, folder: Path) -> Iterator[Run]:
    """Run the blocks of the text of a page in a folder, one after the other."""
    environment = prepare(folder)
    for block in BLOCK.finditer(page):
        text = re.sub(f"^{block['indent']}", "", block["text"], flags=re.M)
        if block["file"]:
            (folder / block["file"]).write_text(text, encoding="utf-8")
        program = {"sh": ["bash", "-e"], "python": [sys.executable]}.get(block["language"])
        if program and ELSEWHERE not in text:
            done = subprocess.run(
                [*program, "-c", text],
                **{"cwd": folder, "env": environment, "timeout": HUNG},
                **{"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT},
                **{"text": True, "check": False},
            )
            printed = "\n".join(line.rstrip() for line in done.stdout.splitlines())
            place = block.span("shown")
            yield Run(text, block["shown"], place, done.returncode, printed)


def missing(shown: str, printed: str) -> str:
    """Return the first part between `...` that was not printed after the parts before; or ""."""
    rest = printed
    for part in ELLIPSIS.split(shown):
        wanted = part.strip("\n")
        if wanted not in rest:
            return wanted
        rest = rest[rest.index(wanted) + len(wanted) :]
    return ""


def renewed(shown: str, printed: str) -> str:
    """Return what a page is to show: the lines of each part as printed."""

    def words(line: str) -> str:
        return " ".join(re.findall(r"[^\W\d]{2,}", line))

    lines, at, parts = printed.splitlines(), 0, []
    for part in ELLIPSIS.split(shown):
        old = part.strip("\n").splitlines()
        places = {
            k: sum(a == b for a, b in zip(part.split(), " ".join(lines[k : k + len(old)]).split()))
            for k in range(at, len(lines) - len(old) + 1)
            if [words(line) for line in lines[k : k + len(old)]] == [words(line) for line in old]
        }
        if not places:
            raise SystemExit(f"not printed any more:\n{part}\nbut:\n{printed}")
        start = max(places, key=lambda k: places[k])
        at = start + len(old)
        parts.append("\n".join(lines[start:at]))
    text = "\n...\n".join(parts).removeprefix("\n").removesuffix("\n")
    return f"{text}\n"


def main() -> None:
    """Renew the outputs that pages show."""
    for page in sys.argv[1:] or PAGES:
        text = text_of(page)
        with tempfile.TemporaryDirectory() as folder:
            shown = [run for run in runs(text, Path(folder)) if run.shown is not None]
        for run in reversed(shown):
            start, end = run.place
            text = text[:start] + renewed(run.shown or "", run.printed) + text[end:]
        (ROOT / f"docs/{page}.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
