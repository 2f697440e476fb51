#!/usr/bin/env python3
"""Put plausible bugs into a copy of the package, one at a time, and see whether its tests notice.

The bugs are in `mutations.toml`: each replaces one text, found once in its file, by another, and
names the tests that should notice. Not part of `make test`:

    python tests/mutations/run.py [--only NAME] [--jobs 2] [--check]

Exit code: 0 if every bug is noticed, 1 if some survive, 2 if the list does not fit the code.
"""

import argparse
import ast
import os
import queue
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import tomllib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LIST = Path(__file__).with_name("mutations.toml")
NEEDED = ("cpid_drake", "models", "diagrams", "tests", "pyproject.toml", "README.md", "LICENSE")
MOST_CPU_SECONDS = 600


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


def run_tests(root: Path, tests: list[str], most_failures: int = 1) -> tuple[int, list[str]]:
    """Run tests in a copy until so many fail: pytest's exit code; what failed, or its output."""
    limit = (MOST_CPU_SECONDS, MOST_CPU_SECONDS)
    options = [f"--maxfail={most_failures}", "-q", "-p", "no:cacheprovider"]
    run = subprocess.run(
        [sys.executable, "-B", "-m", "pytest", *options, *tests],
        cwd=root / "tests",
        env=os.environ | {"PYTHONPATH": str(root), "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, limit),
        check=False,
    )
    failed = re.findall(r"^(?:FAILED|ERROR) (\S.*?)(?: - .*)?$", run.stdout, re.M)
    return run.returncode, failed or [run.stdout[-300:] + run.stderr[-300:]]


def verdict(mutation: Mutation, root: Path) -> tuple[str, str]:
    """Return 'noticed', 'SURVIVED' or 'BROKEN', and by which test or why; `root` is as before."""
    path = root / "cpid_drake" / mutation.file
    original = path.read_text(encoding="utf-8")
    mutation.apply(root)
    try:
        code, failed = run_tests(root, mutation.tests)
    finally:
        path.write_text(original, encoding="utf-8")
    if code == 0:
        return "SURVIVED", " ".join(mutation.tests)
    if code < 0:
        return "noticed", f"the tests do not end, or crash: signal {-code}"
    if code not in (1, 2):
        return "BROKEN", failed[0]
    return "noticed", failed[0].removeprefix("tests/")


def main() -> int:
    """Try the bugs, and print what noticed each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", metavar="NAME", help="bugs whose name or file contains this")
    parser.add_argument("--jobs", type=int, default=2, help="so many at the same time")
    parser.add_argument("--check", action="store_true", help="see only whether the list fits")
    args = parser.parse_args()

    chosen = [m for m in mutations() if not args.only or args.only in f"{m.name} {m.file}"]
    with tempfile.TemporaryDirectory() as folder:
        copies: queue.Queue[Path] = queue.Queue()
        for job in range(args.jobs):
            copies.put(Path(folder, str(job)))
            Path(folder, str(job)).mkdir()
            copy_to(Path(folder, str(job)))

        problems = []
        for mutation in chosen:
            path = Path(folder, "0", "cpid_drake", mutation.file)
            try:
                mutation.apply(Path(folder, "0"))
            except ValueError as error:
                problems.append(str(error))
            else:
                shutil.copy(ROOT / "cpid_drake" / mutation.file, path)
        if problems:
            print(*problems, sep="\n", file=sys.stderr)
            return 2
        if args.check:
            print(f"{len(chosen)} mutations fit the code")
            return 0

        def attempt(mutation: Mutation) -> tuple[str, str]:
            root = copies.get()
            try:
                result = verdict(mutation, root)
            finally:
                copies.put(root)
            print(f"{result[0]:8} {mutation.name}: {result[1]}", flush=True)
            return result

        with ThreadPoolExecutor(args.jobs) as pool:
            verdicts = list(pool.map(attempt, chosen))
        results = [result for result, _ in verdicts]
        noticing = sorted(
            {test for result, test in verdicts if result == "noticed" and "::" in test}
        )
        if noticing:
            code, failed = run_tests(Path(folder, "0"), noticing, len(noticing))
            if code:
                print("BROKEN: these fail without a bug, too:", *failed, sep="\n  ")
                results.append("BROKEN")
    print(f"noticed {results.count('noticed')} of {len(chosen)}")
    return 2 if "BROKEN" in results else int("SURVIVED" in results)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except ValueError as error:
        sys.exit(f"run.py: {error}")
