#!/usr/bin/env python3
"""Measure the figures of the estimators of noisy sensors, online and batch, case by case.

Every case has a true motion, sensors and faults (figure_cases.py). The estimators get the same
samples. One row for each case and estimator:

- fail: trials without an estimate; the reason of the first is below the row;
- known: smallest and largest number of entries that a trial calls known / number that the bound
  calls known, + number of entries in all trials that are called known, but not by the bound;
- rmse/crlb: worst and mean over the entries, relative to the Cramér-Rao bound of the case without
  firings and faults;
- ref: RMSE relative to the case without firings or faults, if that case ran before;
- cover: share of the known entries whose 95 % interval contains the truth;
- worst: largest error over σ;
- nees: mean over trials, and the band of 95 % for a consistent estimator;
- alarms: trials with changes of momentum that did not happen, and the number of these changes;
- found: share of trials that found all firings, and the largest delay from the last one's start;
- d: RMS difference from the trajectory fit on the same samples, in units of the bound;
- cpu: processor time of a trial.

Use `--check` to see that the truth of a case is right, without any estimator of noisy sensors:
the error of the total momentum, of the rates against differences of the poses, and of least squares
on exact states.
"""

import argparse
import json
import os
import sys
import tempfile
import time
import warnings
from dataclasses import asdict
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from figure_cases import CASES, GROUPS
from figure_statistics import Statistics, relative_rmse, statistics_of
from figure_trials import Job, check_truth, run

from cpid_drake.input_files.validation import nulls
from cpid_drake.studies.trials import bound_of, ideal_samples

BATCH = "trajectory_fit"
HEADER = (
    f"{'case':22}{'estimator':16}{'n':>4}{'fail':>5}{'known':>10}{'rmse/crlb':>19}{'ref':>9}"
    f"{'cover':>7}{'worst':>9}{'nees':>10} {'[band]':12}"
    f"{'alarms':>7}{'found':>12}{'d':>9}{'cpu s':>8}"
)
CHECK_HEADER = f"{'case':22}{'momentum':>10}{'rates':>10}{'error':>10}{'known':>7}"


def main() -> None:
    """Run the cases, print the table and write it as JSON."""
    args = _arguments()
    if args.list:
        for name, figure in CASES.items():
            print(f"{figure.group:10} {name}")
        return
    warnings.simplefilter("ignore")
    names = [*args.case, *(n for n, f in CASES.items() if f.group in args.group)]
    estimators = tuple(args.estimators.split(","))
    results: dict[str, dict[str, Statistics]] = {}
    rows = []
    print(CHECK_HEADER if args.check else HEADER)
    with tempfile.TemporaryDirectory() as folder:
        for name in dict.fromkeys(names):
            begin = time.perf_counter()
            case = CASES[name].build(Path(folder))
            spacecraft = case.spacecraft.make()
            if args.check:
                check = check_truth(case, spacecraft)
                print(
                    f"{name:22}{check.momentum:>10.1e}{check.rates:>10.1e}{check.error:>10.1e}"
                    f"{check.known:>7}",
                    flush=True,
                )
                continue
            ideal = ideal_samples(case, spacecraft.tree, spacecraft.joint_names)
            bound = bound_of(case, spacecraft, ideal)
            job = Job(case, CASES[name].faults, estimators, ideal, args.noiseless)
            trials = run(job, args.trials, args.jobs, lambda done, name=name: _log(name, done))
            batch = trials.get(BATCH)
            results[name] = {
                each: statistics_of(case, bound, found, None if each == BATCH else batch)
                for each, found in trials.items()
            }
            seconds = time.perf_counter() - begin
            for estimator, figures in results[name].items():
                reference = results.get(CASES[name].reference, {}).get(estimator)
                relative = relative_rmse(figures, reference) if reference else np.nan
                print(_row(name, estimator, figures, relative), flush=True)
                rows.append(_entry(name, estimator, figures, relative, seconds))
                rows[-1]["error"] = [nulls(trial.error) for trial in trials[estimator]]
                rows[-1]["sigma"] = [nulls(trial.sigma) for trial in trials[estimator]]
            if args.out is not None:
                args.out.write_text(json.dumps(rows, indent=1, allow_nan=False), encoding="utf-8")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--case", action="append", default=[], choices=CASES, metavar="NAME")
    parser.add_argument("--group", action="append", default=[], choices=GROUPS)
    parser.add_argument("--list", action="store_true", help="list the cases")
    parser.add_argument("--trials", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=1, help="number of processes")
    parser.add_argument("--estimators", default=f"{BATCH},recursive_fit", help="comma-separated")
    parser.add_argument("--noiseless", action="store_true", help="use samples without noise")
    parser.add_argument("--check", action="store_true", help="check the truth of the cases only")
    parser.add_argument("--out", type=Path, help="JSON file of the rows, with all errors and σ")
    return parser.parse_args()


def _log(name: str, done: int) -> None:
    if sys.stderr.isatty():
        print(f"\r{name}: {done} trials ", end="", file=sys.stderr, flush=True)


def _row(name: str, estimator: str, figures: Statistics, relative: float) -> str:
    f = figures
    low, high = f.known
    known = f"{low}-{high}/{f.known_by_bound}" if low != high else f"{low}/{f.known_by_bound}"
    known += f"+{f.not_observed}" if f.not_observed else ""
    ratio = f"{f.ratio.max():.3g} {f.ratio.mean():.3g}" if f.ratio.size else "-"
    alarms = "-" if f.false_alarms is None else f"{f.false_alarms[0]}/{f.false_alarms[1]}"
    found = "-" if f.found is None else f"{100 * f.found[0]:.0f}% {f.found[1]:.2f}s"
    band = f"[{f.nees_band[0]:.3g},{f.nees_band[1]:.3g}]"
    text = (
        f"{name:22}{estimator:16}{f.trials:>4}{f.failed:>5}{known:>10}{ratio:>19}"
        f"{_number(relative, '.3g'):>9}{_number(100 * f.coverage, '.1f'):>7}"
        f"{_number(f.worst, '.3g'):>9}{_number(f.nees, '.3g'):>10} {band:12}{alarms:>7}{found:>12}"
        f"{_number(f.difference, '.3g'):>9}{_number(f.seconds, '.2f'):>8}"
    )
    return text + (f"\n    {f.problem[:150]}" if f.problem else "")


def _number(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "-"


def _entry(
    name: str, estimator: str, figures: Statistics, relative: float, seconds: float
) -> dict[str, object]:
    """Return a row as plain numbers; missing ones are None."""
    entry = {
        key: nulls(value) if isinstance(value, float | tuple | np.ndarray) else value
        for key, value in asdict(figures).items()
    }
    entry |= {"relative_rmse": nulls(relative), "case_seconds": seconds}
    return {"case": name, "estimator": estimator, "group": CASES[name].group} | entry


if __name__ == "__main__":
    main()
