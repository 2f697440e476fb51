#!/usr/bin/env python3
"""Put plausible bugs into a copy of the package, one at a time, and see whether its tests notice.

The bugs are in `mutations.toml`: each replaces one text, found once in its file, by another, and
names the tests that should notice. Not part of `make test`:

    python tests/mutations/run.py [--only NAME] [--jobs 2] [--check]

Exit code: 0 if every bug is noticed, 1 if some survive, 2 if the list does not fit the code.
"""

import argparse
import ast
import importlib
import os
import re
import resource
import shutil
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest

sys.dont_write_bytecode = True
os.environ["OPENBLAS_NUM_THREADS"] = "1"

ROOT = Path(__file__).resolve().parents[2]
LIST = Path(__file__).with_name("mutations.toml")
NEEDED = ("cpid_drake", "models", "diagrams", "tests", "pyproject.toml", "README.md", "LICENSE")
MOST_CPU_SECONDS = 600
PRELOADED = ("pydrake.all", "scipy.interpolate", "scipy.optimize", "scipy.spatial.transform")


@dataclass(frozen=True)
class Mutation:
    """A plausible bug: `old` becomes `new` in a file of the package; these tests should fail."""

    name: str
    file: str
    old: str
    new: str
    tests: list[str]

    def apply(self, root: Path) -> None:
        """Put the bug into the package below `root`.

        Raises:
            ValueError: the text is not found once, the result is no Python, or a test is missing.
        """
        path = root / "cpid_drake" / self.file
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        count = text.count(self.old)
        if count != 1:
            raise ValueError(f"{self.name}: found {count} times in {self.file}: {self.old!r}")
        changed = text.replace(self.old, self.new)
        try:
            ast.parse(changed)
        except SyntaxError as error:
            raise ValueError(f"{self.name}: {self.file} is no Python then: {error}") from error
        for test in self.tests:
            if not (root / "tests" / test.partition("::")[0]).exists():
                raise ValueError(f"{self.name}: no such test: {test}")
        path.write_text(changed, encoding="utf-8")


def mutations() -> list[Mutation]:
    """Read the list."""
    found = [Mutation(**entry) for entry in tomllib.loads(LIST.read_text("utf-8"))["mutation"]]
    names = [mutation.name for mutation in found]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ValueError(f"names used twice: {', '.join(repeated)}")
    return found


def copy_to(folder: Path) -> None:
    """Copy what the tests need."""
    for name in NEEDED:
        source = ROOT / name
        if source.is_dir():
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(source, folder / name, ignore=ignored, dirs_exist_ok=True)
        else:
            shutil.copy(source, folder / name)


def start_tests(root: Path, tests: list[str], most_failures: int = 1) -> int:
    """Run tests in a copy until so many fail, in a fork of this process: return the child's id.

    What takes long to import is imported already (`PRELOADED`), but nothing of the package. The
    child's exit code is pytest's; its output is in `root / "output.txt"`.
    """
    child = os.fork()
    if child:
        return child
    code = 3
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (MOST_CPU_SECONDS, MOST_CPU_SECONDS))
        output = os.open(root / "output.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(output, 1)
        os.dup2(output, 2)
        os.chdir(root / "tests")
        os.environ["PYTHONPATH"] = str(root)
        sys.path.insert(0, str(root))
        options = [f"--maxfail={most_failures}", "-q", "-p", "no:cacheprovider"]
        code = int(pytest.main([*options, *tests]))
    finally:
        sys.stdout.flush()
        os._exit(code)


def finish_tests(root: Path, status: int) -> tuple[int, list[str]]:
    """Return pytest's exit code, or minus the signal, and what failed, or the end of its output."""
    output = (root / "output.txt").read_text(encoding="utf-8", errors="replace")
    failed = re.findall(r"^(?:FAILED|ERROR) (\S.*?)(?: - .*)?$", output, re.M)
    return os.waitstatus_to_exitcode(status), failed or [output[-600:]]


def verdict(mutation: Mutation, root: Path, status: int) -> tuple[str, str]:
    """Return 'noticed', 'SURVIVED' or 'BROKEN', and by which test or why."""
    code, failed = finish_tests(root, status)
    if code == 0:
        return "SURVIVED", " ".join(mutation.tests)
    if code < 0:
        return "noticed", f"the tests do not end, or crash: signal {-code}"
    if code not in (1, 2):
        return "BROKEN", failed[0]
    return "noticed", failed[0].removeprefix("tests/")


def try_all(chosen: list[Mutation], copies: list[Path]) -> list[tuple[str, str]]:
    """Put each bug into one of the copies, run its tests there, and print what noticed it."""
    free, waiting, running, verdicts = list(copies), list(chosen), {}, []
    while waiting or running:
        while waiting and free:
            mutation, root = waiting.pop(0), free.pop()
            mutation.apply(root)
            running[start_tests(root, mutation.tests)] = mutation, root
        child, status = os.wait()
        mutation, root = running.pop(child)
        shutil.copy(ROOT / "cpid_drake" / mutation.file, root / "cpid_drake" / mutation.file)
        verdicts.append(verdict(mutation, root, status))
        print(f"{verdicts[-1][0]:8} {mutation.name}: {verdicts[-1][1]}", flush=True)
        free.append(root)
    return verdicts


def main() -> int:
    """Try the bugs, and print what noticed each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", metavar="NAME", help="bugs whose name or file contains this")
    parser.add_argument("--jobs", type=int, default=2, help="so many at the same time")
    parser.add_argument("--check", action="store_true", help="see only whether the list fits")
    args = parser.parse_args()

    chosen = [m for m in mutations() if not args.only or args.only in f"{m.name} {m.file}"]
    with tempfile.TemporaryDirectory() as folder:
        copies = [Path(folder, str(job)) for job in range(args.jobs)]
        for copy in copies:
            copy.mkdir()
            copy_to(copy)

        fitting = []
        for mutation in chosen:
            path = copies[0] / "cpid_drake" / mutation.file
            original = path.read_bytes() if path.is_file() else b""
            try:
                mutation.apply(copies[0])
            except ValueError as error:
                print(f"BROKEN   {error}", flush=True)
            else:
                path.write_bytes(original)
                fitting.append(mutation)
        if args.check:
            print(f"{len(fitting)} of {len(chosen)} mutations fit the code")
            return 0 if len(fitting) == len(chosen) else 2

        for name in PRELOADED:
            importlib.import_module(name)
        verdicts = try_all(fitting, copies)
        results = [result for result, _ in verdicts]
        noticing = sorted(
            {test for result, test in verdicts if result == "noticed" and "::" in test}
        )
        if noticing:
            _, status = os.waitpid(start_tests(copies[0], noticing, len(noticing)), 0)
            code, failed = finish_tests(copies[0], status)
            if code:
                print("BROKEN: these fail without a bug, too:", *failed, sep="\n  ")
                results.append("BROKEN")
    print(f"noticed {results.count('noticed')} of {len(chosen)}")
    if "BROKEN" in results or len(fitting) < len(chosen):
        return 2
    return int("SURVIVED" in results)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except ValueError as error:
        sys.exit(f"run.py: {error}")
