"""Rows of the reference table: identifications of known targets, compared with the truth."""

import json
import re
import resource
import subprocess
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from logs import Array, World, log_of
from scipy.stats import chi2

from cpid_drake import (
    Identification,
    InputError,
    SensorSuite,
    TotalMomentum,
    identify,
    load_scenario,
    load_sensors,
    read_log,
    shipped_scenario,
)
from cpid_drake.files.checked_yaml import dump_yaml
from cpid_drake.simulation.trials import bound_of, make_case

FLOOR = 1e-8
"""Error that is rounding, relative to m, to 0.5 m and to the trace of I."""

WRONG_SIGMA, WRONG_PROBABILITY = 5.0, 1e-6
"""A trusted answer is wrong with a larger error, or if all its errors are less probable."""

PAIRED = "same draws: first estimate within 0.3 σ of the earlier one, its σ within 10 %"
BAND = "mean NEES in its 99 % band or no farther outside; error over bound at most 15 % larger"
EXACT = "exact data: rounding only, an absolute floor"
CAUGHT = "a refusal, a failed check or a right answer; nothing confidently wrong"


LONGEST = 300
"""Processor time after which a command is killed [s]; its exit code is then negative."""


def nothing() -> Array:
    return np.full(10, np.nan)


@dataclass(frozen=True, eq=False)
class Trial:
    """One answer compared with the truth; entries that are not known are NaN."""

    code: int
    text: str = ""
    seconds: float = 0.0
    error: Array = field(default_factory=nothing)
    sigma: Array = field(default_factory=nothing)
    covariance: Array = field(default_factory=nothing)
    floor: Array = field(default_factory=nothing)
    nees: float = np.nan
    online: float = np.nan

    @property
    def known(self) -> Array:
        return np.isfinite(self.error) & np.isfinite(self.sigma)

    @property
    def in_sigma(self) -> Array:
        return np.abs(self.error[self.known]) / np.hypot(self.sigma, self.floor)[self.known]

    @property
    def relative(self) -> float:
        """Largest error relative to m, 0.5 m and the trace of I."""
        return float(np.max(np.abs(self.error) / self.floor * FLOOR))

    @property
    def is_wrong(self) -> bool:
        """Whether a trusted answer excludes the truth."""
        if self.code not in (0, 3) or not self.known.any():
            return False
        # Intervals may be wider than the covariance.
        widening = self.sigma[self.known] / np.sqrt(np.diag(self.covariance)[self.known])
        likely = chi2.sf(self.nees / np.max(widening) ** 2, self.known.sum())
        return bool(self.in_sigma.max() > WRONG_SIGMA or likely < WRONG_PROBABILITY)


def relative_to(mass: float, pi: Array) -> Array:
    """Return unknowns (10,) in which the relative motion is linear, from m, c and I."""
    m, c, (xx, yy, zz, xy, xz, yz) = pi[0], pi[1:4], pi[4:]
    f = mass / (mass + m)
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    J = inertia + m * f * ((c @ c) * np.eye(3) - np.outer(c, c))
    return np.concatenate([[m * f], m * f * c, J[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]])


def nees_of(
    world: World, estimate: Array, covariance: Array, information: Array | None, floor: Array
) -> float:
    """Return the squared error in units of the covariance, in unknowns that are nearly linear."""
    error = estimate - world.target.to_vector()
    k = np.isfinite(error) & np.isfinite(np.diag(covariance))
    P = (covariance + np.diag(floor**2))[np.ix_(k, k)]
    error = error[k]
    if k.all():
        mass = world.craft.mass
        complex_step = [relative_to(mass, estimate + 1e-30j * unit).imag for unit in np.eye(10)]
        jacobian = np.array(complex_step).T / 1e-30
        error = relative_to(mass, estimate) - relative_to(mass, world.target.to_vector())
        if information is None:
            P = jacobian @ P @ jacobian.T
        else:  # π itself is bent by a mass that is weakly known
            scale = 1 / np.sqrt(np.diag(information))
            P = np.linalg.inv(information * scale * scale[:, None]) * scale * scale[:, None]
            P = P + jacobian @ np.diag(floor**2) @ jacobian.T
    size = np.sqrt(np.diag(P))
    unit = P / np.outer(size, size)
    return float(error / size @ np.linalg.lstsq(unit, error / size, rcond=1e-13)[0])


def _trial(code, text, seconds, world, estimate, intervals, covariance, told) -> Trial:
    trace = float(np.trace(world.target.I_TTcm_C))
    floor = FLOOR * np.array([world.target.mass, *3 * [0.5], *6 * [trace]])
    sigma = np.diff(intervals, axis=1)[:, 0] / 2 / 1.959964
    error, nees = estimate - world.target.to_vector(), np.nan
    if np.isfinite(error).any():
        is_relative = told is not None and told["unknowns"] == "relative"
        order = [0, 1, 2, 3, 4, 7, 9, 5, 6, 8]  # of a file's xx, xy, xz, yy, yz, zz
        information = np.array(told["information"])[np.ix_(order, order)] if is_relative else None
        nees = nees_of(world, estimate, covariance, information, floor)
    return Trial(code, text, seconds, error, sigma, covariance, floor, nees)


def trial_of(found: Identification, world: World, seconds: float = 0.0) -> Trial:
    """Return the comparison of a result with the truth; only here are results read."""
    code = 4 if found.failures else 0 if found.is_complete else 3
    text = "; ".join([*found.failures, *found.warnings])
    parts = found.parameters, found.intervals, found.covariance
    told = None if found.combinations is None else vars(found.combinations)
    return _trial(code, text, seconds, world, *parts, told)


def cli(*words: str | Path) -> subprocess.CompletedProcess:
    """Run `cpid` in another process, which is killed after `LONGEST`."""
    return python("-m", "cpid_drake", *words)


def python(*words: str | Path) -> subprocess.CompletedProcess:
    """Run Python in another process, which is killed after `LONGEST`."""
    command = [sys.executable, *map(str, words)]

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (LONGEST, LONGEST))

    return subprocess.run(command, capture_output=True, text=True, check=False, preexec_fn=limit)


def suite_of(sensors: str) -> SensorSuite:
    """Return a preset without the errors that it does not state, as a simulation has them."""
    return load_sensors(sensors, unstated="exact")


def suite_file(folder: Path, sensors: str) -> Path:
    """Write the same as a file."""
    path = folder / f"{sensors}.yaml"
    path.write_text(dump_yaml(suite_of(sensors)), encoding="utf-8")
    return path


def cli_trial(world: World, folder: Path, log: Path, *words: str | Path) -> Trial:
    """Run `cpid identify` on a log of a world, and compare its result file with the truth."""
    out, craft = folder / "found.json", world.scenario.spacecraft
    out.unlink(missing_ok=True)
    known = [
        "--model",
        craft.model,
        "--base",
        craft.base,
        "--capture-frame",
        craft.capture_frame,
    ]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = cli("identify", log, *known, *words, "--json", out)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    text = done.stderr + done.stdout.split("\nTarget in ")[0][:2000]
    if not out.exists():
        return Trial(done.returncode, text, seconds)
    found = json.loads(out.read_text(encoding="utf-8"))
    keys = "parameters", "intervals", "covariance"
    parts = (np.array(found[key], dtype=float) for key in keys)
    return _trial(done.returncode, text, seconds, world, *parts, found["combinations"])


# fmt: off
def row_of(what: str, trials: Sequence[Trial], *, bound: Array | None = None,
           figures: dict | None = None, why: str = "", is_spoiled: bool = False,
           words: str = "") -> dict:
    # fmt: on
    """Return a row of the table."""
    good = [t for t in trials if t.known.any()]
    freedom = int(sum(t.known.sum() for t in good))
    errors = np.concatenate([t.in_sigma for t in good]) if good else np.full(1, np.nan)
    band = chi2.ppf([0.005, 0.995], freedom) / len(good) if good else [np.nan, np.nan]
    over = None
    if bound is not None and good:
        ratio = np.sqrt(np.nanmean([(t.error / bound) ** 2 for t in good], axis=0))
        over = {"worst": np.nanmax(ratio), "rms": np.sqrt(np.nanmean(ratio**2))}
    first = (good or trials or [Trial(0)])[0]
    named = {"named": all(bool(re.search(words, t.text.lower())) for t in trials)}
    return {
        "what": what,
        "runs": len(trials),
        "known": min((int(t.known.sum()) for t in trials), default=0),
        "error_in_sigma": {"worst": errors.max(), "rms": np.sqrt(np.mean(errors**2))},
        "error_over_bound": over,
        "nees": {"mean": np.mean([t.nees for t in good]) if good else None, "band99": [*band]},
        "coverage95": np.mean(errors <= 1.959964) if good else None,
        "checks_passed": sum(t.code in (0, 3) for t in trials),
        "exit_codes": dict(sorted(Counter(str(t.code) for t in trials).items())),
        "confidently_wrong": sum(t.is_wrong for t in trials),
        "online_minus_batch": max(
            (t.online for t in trials if np.isfinite(t.online)), default=None
        ),
        "figures": figures or {},
        "error": [*first.error],
        "sigma": [*first.sigma],
        "message": next((" ".join(t.text.split())[:200] for t in trials if t.code or words), ""),
        "seconds": np.mean([t.seconds for t in trials]) if trials else None,
        "tolerance": why or (f"{PAIRED}; {BAND}" if len(trials) > 1 else PAIRED),
        "is_spoiled": is_spoiled,
        **(named if words else {}),
    }


def identified(
    world: World, log: Path, suite: SensorSuite, online: bool = False, **options
) -> Trial:
    """Return the answer to a log, and how far the online estimate is from it."""
    warnings.simplefilter("ignore")
    options = {"sensors": suite, "planar": True if world.planar else None, **options}
    begin = time.process_time()
    try:
        data = read_log(log)
        found = identify(world.craft, data, **options)
    except InputError as error:
        return Trial(2, str(error), time.process_time() - begin)
    trial = trial_of(found, world, time.process_time() - begin)
    if not online:
        return trial
    other = identify(world.craft, data, estimator="recursive_fit", **options)
    difference = np.abs(other.parameters - found.parameters) / trial.sigma
    return replace(trial, online=float(np.nanmax(difference, initial=0.0)))


def monte_carlo(what: str, name: str, folder: Path, sensors: str | SensorSuite = "flight",
                seeds: int = 3, *, online: int = 1, bound: bool = False, uncertain: bool = False,
                change: Callable[[World], World] = lambda world: world,
                true: SensorSuite | None = None, is_spoiled: bool = False, why: str = "",
                words: str = "", **options) -> dict:  # fmt: skip
    """Return the row of a scenario with the noise of several seeds."""
    suite = suite_of(sensors) if isinstance(sensors, str) else sensors
    scenario = load_scenario(shipped_scenario(name))
    world, trials = change(World(scenario)), []
    if scenario.identification.momentum == "unknown":
        options["momentum"] = TotalMomentum.unknown()
    if uncertain:
        options["known_bodies"] = scenario.known_bodies
    for seed in range(seeds):
        if uncertain:
            world = World(scenario, np.random.default_rng([3, seed]))
        log = log_of(world, true or suite, seed, folder / "log.parquet")
        trials.append(identified(world, log, suite, seed < online, **options))
    limit = None
    if bound:
        craft = scenario.spacecraft.make()
        case = make_case(scenario, craft, scenario.target_truth(), suite, 0)
        limit = bound_of(case, craft)
    what = f"{what}, {seeds} seeds"
    return row_of(what, trials, bound=limit, is_spoiled=is_spoiled, why=why, words=words)
