#!/usr/bin/env python3
"""Run `cpid identify` on logs that are spoiled on purpose, and judge its answers by the truth.

Every case (log_cases.py) is a log that is wrong in one way, or that comes with a wrong model or
wrong options. A FAIL is exit code 0 with a 95 % interval that excludes the truth by more than
chance. One row for each case and variant of the options:

- code: exit code; worst: largest error of a shown parameter, in σ; verdict, see
  `log_verdicts.Judgement`; named: whether a message names the cause;
- the first line of the message.

With `--clean N`, run on N clean logs of all sources, with noise of matching sensors, and print the
share that does not end with exit code 0 and the share of the intervals that contain the truth.
"""

import argparse
import json
import os
import re
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import cycle, islice
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

from log_case import GROUPS, Case
from log_cases import CASES
from log_sources import SOURCES, Workshop
from log_spoils import columns_of
from log_verdicts import NOT_TRUSTWORTHY, Judgement, judge, run_identify, write_log

VARIANTS: dict[str, tuple[str, ...]] = {
    "default": (),
    "sensors": ("--sensors", "SUITE"),
    "least_squares": ("--estimator", "least_squares"),
    "recursive_fit": ("--estimator", "recursive_fit"),
    "trajectory_fit": ("--estimator", "trajectory_fit"),
    "eq18": ("--rows", "eq18"),
    "least_squares+s": ("--estimator", "least_squares", "--sensors", "SUITE"),
    "recursive_fit+s": ("--estimator", "recursive_fit", "--sensors", "SUITE"),
    "unknown": ("--momentum", "unknown"),
    "unknown+s": ("--momentum", "unknown", "--sensors", "SUITE"),
}
"""Options of `cpid identify` by name of the variant; SUITE is the suite of the source."""

DEFAULT_VARIANTS = ("default", "sensors")
SEED = 1
HEADER = (
    f"{'case':28}{'variant':16}{'s':>5}{'code':>5}{'worst σ':>10} {'entry':6}{'verdict':10}"
    "named message"
)


@dataclass(frozen=True)
class Row:
    """One run of `cpid identify`."""

    case: str
    variant: str
    code: int
    judgement: Judgement
    message: str
    seconds: float

    def __str__(self) -> str:
        j = self.judgement
        named = "yes" if j.is_named else "no"
        numbers = f"{self.seconds:>5.1f}{self.code:>5}{j.worst:>10.3g} {j.entry:6}"
        return (
            f"{self.case:28}{self.variant:16}{numbers}{j.verdict:10}{named:6}{self.message[:150]}"
        )


def run_case(
    name: str, case: Case, workshop: Workshop, folder: Path, variants: tuple[str, ...]
) -> Iterator[Row]:
    """Yield the rows of one spoiled log; variants with sensors only if the source has sensors."""
    source = SOURCES[case.source]
    true = workshop.true_log(case.source, case.motion)
    measurements = true.noisy(SEED)
    if case.samples is not None:
        measurements = case.samples(measurements)
    columns = columns_of(measurements)
    if case.columns is not None:
        columns = case.columns(columns)
    log = folder / "log.npz"  # a name of the case would be in the messages
    write_log(log, columns)
    runs = {"own": case.only} if case.only is not None else {v: VARIANTS[v] for v in variants}
    for variant, options in runs.items():
        if "SUITE" in options and not source.sensors:
            continue
        chosen = (source.sensors if word == "SUITE" else word for word in options)
        begin = time.perf_counter()
        answer = run_identify(log, true.case.spacecraft, case.capture_frame, *case.options, *chosen)
        seconds = time.perf_counter() - begin
        found = judge(answer, true.case.truth, case.words)
        yield Row(name, variant, answer.code, found, answer.message, round(seconds, 2))


def run_clean(
    count: int, offset: int, workshop: Workshop, folder: Path, variants: tuple[str, ...]
) -> Iterator[Row]:
    """Yield the rows of clean logs; seeds, sources and variants take turns.

    Args:
        count: number of runs.
        offset: number of the first run, so that several processes can share the runs.
        workshop: makes the logs.
        folder: folder of the logs.
        variants: names of the variants.

    """
    pairs = [
        (source, variant)
        for source in SOURCES
        for variant in variants
        if SOURCES[source].sensors or "SUITE" not in VARIANTS[variant]
    ]
    for number, (name, variant) in islice(enumerate(cycle(pairs)), offset, offset + count):
        source = SOURCES[name]
        true = workshop.true_log(name)
        log = folder / "log.npz"
        write_log(log, columns_of(true.noisy(100 + number // len(pairs))))
        options = [source.sensors if word == "SUITE" else word for word in VARIANTS[variant]]
        known = [] if "--momentum" in options else list(source.options)
        begin = time.perf_counter()
        answer = run_identify(log, true.case.spacecraft, "", *known, *options)
        seconds = time.perf_counter() - begin
        found = judge(answer, true.case.truth)
        yield Row(name, variant, answer.code, found, answer.message, round(seconds, 2))


def summary(rows: list[Row]) -> dict[str, float]:
    """Return the counts and shares over spoiled logs."""
    verdicts = Counter(row.judgement.verdict for row in rows)
    caught = [row for row in rows if row.judgement.verdict not in ("right", "open")]
    named = sum(row.judgement.is_named for row in caught)
    failed = {row.case for row in rows if row.judgement.verdict in ("FAIL", "crash")}
    return {
        "runs": len(rows),
        "cases": len({row.case for row in rows}),
        "cases_that_fail": len(failed),
        **{f"runs_{verdict}": number for verdict, number in sorted(verdicts.items())},
        "share_of_runs_FAIL": round(verdicts["FAIL"] / max(len(rows), 1), 4),
        "share_named_of_not_right": round(named / max(len(caught), 1), 4),
    }


def clean_summary(rows: list[Row]) -> dict[str, float]:
    """Return the shares over clean logs."""
    n = max(len(rows), 1)
    shown = [row.judgement for row in rows if row.judgement.known]
    known, inside = sum(j.known for j in shown), sum(j.inside for j in shown)
    return {
        "runs": len(rows),
        "share_exit_4": round(sum(row.code == NOT_TRUSTWORTHY for row in rows) / n, 4),
        "share_exit_not_0": round(sum(row.code != 0 for row in rows) / n, 4),
        "runs_FAIL": sum(row.judgement.verdict in ("FAIL", "wrong", "crash") for row in rows),
        "share_of_intervals_that_hold": round(inside / max(known, 1), 4),
    }


def main() -> None:
    """Run the cases or the clean logs, print the table and write it as JSON."""
    args = _arguments()
    warnings.simplefilter("ignore")
    variants = tuple(VARIANTS) if args.all else tuple(args.variants.split(","))
    if args.list:
        for name, case in CASES.items():
            print(f"{case.group:10}{case.source:20}{name}")
        return
    print(HEADER, flush=True)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        workshop = Workshop(Path(folder))
        if args.clean:
            runs = run_clean(args.clean, args.offset, workshop, Path(folder), variants)
        else:
            chosen = {
                name: case
                for name, case in CASES.items()
                if re.search(args.case, name) and case.group in (args.group or GROUPS)
            }
            runs = (
                row
                for name, case in chosen.items()
                for row in run_case(name, case, workshop, Path(folder), variants)
            )
        for row in runs:
            rows.append(row)
            is_quiet = args.clean and row.code == 0 and not row.judgement.is_wrong
            if not is_quiet:
                print(row, flush=True)
    totals = clean_summary(rows) if args.clean else summary(rows)
    print(json.dumps(totals, indent=2))
    if args.json:
        document = {"summary": totals, "rows": [asdict(row) for row in rows]}
        args.json.write_text(json.dumps(document, indent=1), encoding="utf-8")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--case", default=".", help="regular expression of names of cases")
    parser.add_argument("--group", action="append", choices=GROUPS, help="may be repeated")
    parser.add_argument("--variants", default=",".join(DEFAULT_VARIANTS), help="names, by commas")
    parser.add_argument("--all", action="store_true", help="run all variants")
    parser.add_argument("--clean", type=int, default=0, metavar="N", help="run N clean logs")
    parser.add_argument("--offset", type=int, default=0, help="number of the first clean run")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all rows to this file")
    parser.add_argument("--list", action="store_true", help="list the cases")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
