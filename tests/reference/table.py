#!/usr/bin/env python3
"""Make the reference table, or compare a new run with it.

Each case (cases.py) runs in a process of its own, two at a time. `--compare` prints what moved, and
fails where an error, a σ or a NEES moved by more than the tolerance of its row, or a verdict became
worse. Times and memory are printed only: they belong to the machine.
"""

import argparse
import json
import math
import os
import platform
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

TABLE = Path(__file__).with_name("table.json")

ESTIMATE, SIGMA, BOUND, ONLINE = 0.3, 0.1, 0.15, 0.1
"""Tolerances: first estimate [σ], σ (relative), error over the bound (relative), online [σ]."""


def main() -> int:
    """Run the cases; write the table, or compare with it."""
    args = _arguments()
    if args.one:
        _run_one(args.one, args.out)
        return 0
    names = args.cases.split(",") if args.cases else case_names()
    if unknown := set(names) - set(case_names()):
        sys.exit(f"no case {', '.join(sorted(unknown))}; the cases are {', '.join(case_names())}")
    old = json.loads(TABLE.read_text(encoding="utf-8"))["rows"] if TABLE.exists() else {}
    new: dict[str, dict] = {}
    for rows in run(names, args.jobs):
        new |= rows
        if not args.compare:  # after each case: an interrupted run keeps what is finished
            table = {"machine": machine(), "rows": (old if args.cases else {}) | new}
            text = json.dumps(table, indent=1, ensure_ascii=False, allow_nan=False)
            (args.out or TABLE).write_text(text + "\n", encoding="utf-8")
    if not args.compare:
        return 0
    missing = (
        [] if args.cases else [(True, f"{n}: the row is missing") for n in old if n not in new]
    )
    found = missing + compare(old, new)
    for fails, text in found:
        print("FAIL" if fails else "    ", text)
    failures = sum(fails for fails, _ in found)
    print(f"{len(new)} rows, {len(found)} figures moved, {failures} by more than their tolerance")
    return int(failures > 0)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--compare", action="store_true", help="compare with the table")
    parser.add_argument("--cases", default="", help="names of cases, with commas between them")
    parser.add_argument("--jobs", type=int, default=2, help="number of processes")
    parser.add_argument("--out", type=Path, help="write the table to this file")
    parser.add_argument("--one", default="", help=argparse.SUPPRESS)
    return parser.parse_args()


def case_names() -> list[str]:
    """Return the names of the cases, not imported here: processes inherit the peak of memory."""
    text = Path(__file__).with_name("cases.py").read_text(encoding="utf-8")
    lines = text[text.index("\nCASES:") :].splitlines()
    return [line.split('"')[1] for line in lines if line.startswith('    "')]


def _run_one(name: str, out: Path) -> None:
    """Run one case in this process and write its rows."""
    from cases import CASES

    with tempfile.TemporaryDirectory() as folder:
        found = CASES[name](Path(folder))
    rows = {name: found} if "runs" in found else found
    out.write_text(json.dumps(_rounded(rows)), encoding="utf-8")


def run(names: list[str], jobs: int = 2) -> Iterator[dict[str, dict]]:
    """Yield the rows of cases, each from a process of its own."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}

    def one(name: str) -> dict[str, dict]:
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "rows.json"
            words = [sys.executable, __file__, "--one", name, "--out", str(out)]
            _, status, used = os.wait4(os.posix_spawn(sys.executable, words, environment), 0)
            rows = {name: {}} if status else json.loads(out.read_text(encoding="utf-8"))
        cost = {
            "case_seconds": round(used.ru_utime + used.ru_stime, 1),
            "case_peak_megabytes": round(used.ru_maxrss / 1024),
        }
        print(
            f"{name:22} {'crashed' if status else ''}", *cost.values(), file=sys.stderr, flush=True
        )
        return {row: {**figures, **cost} for row, figures in rows.items()}

    with ThreadPoolExecutor(jobs) as pool:
        yield from pool.map(one, names)


def machine() -> dict[str, str | int]:
    """Return what the times depend on, and the date."""
    cpu = platform.processor() or platform.machine()
    if (info := Path("/proc/cpuinfo")).exists():
        lines = info.read_text().splitlines()
        cpu = next((x.split(":")[1].strip() for x in lines if x.startswith("model name")), cpu)
    packages = {name: version(name) for name in ("drake", "numpy", "scipy")}
    now = {"date": datetime.now(UTC).date().isoformat(), "python": platform.python_version()}
    return {"cpu": cpu, "cores": os.cpu_count() or 1, **now, **packages}


def compare(old: dict[str, dict], new: dict[str, dict]) -> list[tuple[bool, str]]:
    """Return what moved in rows by name, each with whether it fails."""
    found = []
    for name, row in new.items():
        if name in old:
            found += [(bool(fails), f"{name}: {text}") for fails, text in _moved(old[name], row)]
        else:
            found.append((False, f"{name}: new"))
    return found


def _moved(old: dict, new: dict) -> Iterator[tuple[bool, str]]:
    """Yield what moved in a row, each with whether it fails."""
    if "runs" not in new or "runs" not in old:
        yield "runs" not in new, "the case crashed" if "runs" not in new else "crashes no longer"
        return

    def text(what: str, *values) -> str:
        return (
            f"{what} {' -> '.join(f'{v:.4g}' if isinstance(v, float) else str(v) for v in values)}"
        )

    is_clean = not old["is_spoiled"]
    worse = {"confidently_wrong": 1, "named": -1}
    if is_clean:
        worse |= {"checks_passed": -1, "known": -1}
    for key in ("confidently_wrong", "named", "checks_passed", "known", "exit_codes"):
        before, after = old.get(key, 0), new.get(key, 0)
        if before != after:
            fails = key in worse and worse[key] * (int(after) - int(before)) > 0
            yield fails, text(key, before, after)
    both = zip(old["error"], old["sigma"], new["error"], new["sigma"])
    known = [each for each in both if None not in each]
    if known and not old["tolerance"].startswith("exact"):
        shift = max(abs(e - e0) / s0 for e0, s0, e, _ in known)
        if shift > ESTIMATE / 10:
            yield is_clean and shift > ESTIMATE, text("first estimate moved, in σ:", shift)
        ratio = max((s / s0 for _, s0, _, s in known), key=lambda r: abs(math.log(r)))
        if abs(ratio - 1) > SIGMA / 10:
            yield is_clean and abs(ratio - 1) > SIGMA, text("σ over the earlier one:", ratio)
        before, after, (low, high) = old["nees"]["mean"], new["nees"]["mean"], new["nees"]["band99"]
        if abs(after - before) > 0.02 * before:
            middle, outside = (low + high) / 2, not low <= after <= high
            farther = abs(after - middle) > 1.02 * abs(before - middle)
            yield is_clean and outside and farther and old["runs"] > 1, text("NEES", before, after)
    before, after = old["error_over_bound"], new["error_over_bound"]
    if before and after and abs(after["rms"] - before["rms"]) > 0.02 * before["rms"]:
        fails = after["rms"] > (1 + BOUND) * before["rms"]
        yield fails, text("error over bound", before["rms"], after["rms"])
    before, after = old["online_minus_batch"], new["online_minus_batch"]
    if None not in (before, after) and abs(after - before) > ONLINE / 10:
        yield after > max(ONLINE, 1.1 * before), text("online minus batch, in σ:", before, after)
    for key, figure in old["figures"].items():
        before, after = figure["value"], new["figures"].get(key, {}).get("value")
        if before is None or after is None:
            if before != after:
                yield after is None, text(key, before, after)
        elif "at_most" in figure:
            if after > figure["at_most"]:
                yield True, text(key, before, after)
        elif abs(after - before) > figure["within"] * abs(before):
            yield True, text(key, before, after)
    for key in ("case_seconds", "case_peak_megabytes"):
        if not 0.67 < new[key] / old[key] < 1.5:
            yield False, text(key, old[key], new[key])


def _rounded(value):
    """Return numbers with seven digits, and None for those that are not finite."""
    if isinstance(value, dict):
        return {key: _rounded(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_rounded(each) for each in value]
    value = value.item() if hasattr(value, "item") else value
    if not isinstance(value, float):
        return value
    return float(f"{value:.7g}") if math.isfinite(value) else None


if __name__ == "__main__":
    sys.exit(main())
