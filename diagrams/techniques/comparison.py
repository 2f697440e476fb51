"""All techniques on the same motion, noise and targets. A new one needs its record here."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake import (
    InertialParameters,
    InputError,
    Scenario,
    Spacecraft,
    TotalMomentum,
    load_sensors,
)
from cpid_drake.simulation.trials import make_case
from techniques import one_joint, rows
from techniques.force_sensors import ForceSensors
from techniques.records import FIT, ONLINE, PLANAR, Technique, techniques
from techniques.trial import Truth
from techniques.work import shared_work

Array = NDArray[np.float64]
Numbers = dict[str, float]

ONE_JOINT = "one joint after another"
"""The name of that motion."""

SUITES = ("flight", "servicer")
"""The sensors that are compared: very good ones, and ordinary ones."""

SCENARIO, GENERIC = "scenario", "generic"
"""The targets: the scenario's, and one without the symmetry that flatters planar relations."""

_TURN = Rotation.from_euler("xyz", [0.7, -0.4, 1.1]).as_matrix()
WITHOUT_SYMMETRY = InertialParameters(
    100.0, np.array([0.43, 0.12, -0.08]), _TURN @ np.diag([20.0, 30.0, 14.0]) @ _TURN.T
)
"""That target."""


@dataclass(frozen=True, eq=False)
class Cell:
    """A motion, sensors and a target by name, what they do, and the techniques that get them."""

    motion: str
    sensors: str
    target: str
    truth: Truth
    techniques: tuple[str, ...]


Key = tuple[str, str, str, str]
"""Technique, motion, sensors, target."""


@dataclass(frozen=True, eq=False)
class TechniqueComparison:
    """The results of `run_comparison`.

    Attributes:
        records: the techniques.
        cells: the cases.
        numbers: of each technique in each case: of an estimate "exact" (error with exact data),
            "bound", "rms", "low" and "high" (95 % interval of the RMS error, by resampling of the
            trials), "trials", "estimates" (trials that gave one) and "seconds" (median computing
            time of an estimate, after smoothing); errors are those of the worst of ten parameters
            relative to their scale. An experiment has numbers of its own.
        problems: the first failure.
        trials, seed: of the run.

    """

    records: tuple[Technique, ...]
    cells: tuple[Cell, ...]
    numbers: Mapping[Key, Numbers]
    problems: Mapping[Key, str]
    trials: int
    seed: int

    def number(
        self,
        technique: str,
        motion: str,
        quantity: str = "rms",
        sensors: str = SUITES[0],
        target: str = SCENARIO,
    ) -> float:
        """Return one number, NaN if it was not run."""
        return self.numbers.get((technique, motion, sensors, target), {}).get(quantity, np.nan)


Task = tuple[int, str, int]
"""The number of a cell, the name of an experiment, and the number of a trial; −1 for exact data."""


def run_comparison(
    scenarios: Mapping[str, Scenario],
    sensors: ForceSensors,
    *,
    trials: int = 20,
    seed: int = 2016,
    jobs: int = 1,
    is_fast: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> TechniqueComparison:
    """Compare the techniques.

    Each scenario is run with each of `SUITES`; if its spacecraft is known exactly, also with a
    target without symmetry and with the experiments; and the first with one joint after another.

    Args:
        scenarios: by name.
        sensors: the sensors of forces.
        trials: draws of the noise in each cell.
        seed: of all random numbers.
        jobs: number of processes.
        is_fast: whether to leave out the network and the adaptive control.
        progress: called with the numbers of finished and of all tasks.

    Raises:
        InputError: a number is not positive, a sensor is overloaded, or a scenario has a momentum,
            thrust, a table or joints without effort limits.

    """
    for name, value in (("trials", trials), ("jobs", jobs), ("seed", seed + 1)):
        if value < 1:
            raise InputError(f"{name} must be at least 1, not {value}")
    records = tuple(each for each in techniques(sensors) if not (is_fast and each.is_slow))
    cells = tuple(_cells(scenarios, records, seed))
    tasks: list[Task] = [(k, "", -1) for k in range(len(cells))]  # refuses what is overloaded
    own = [each.name for each in records if each.experiment is not None]
    pairs = product(own, range(len(cells)))
    tasks += [(k, name, 0) for name, k in pairs if name in cells[k].techniques]
    tasks += [(k, "", number) for number in range(trials) for k in range(len(cells))]
    found = dict[Task, dict[str, dict[str, Any]]]()
    for task, result in zip(tasks, shared_work(_worker, (cells, sensors), tasks, jobs)):
        found[task] = result
        progress(len(found), len(tasks))
    numbers, problems = dict[Key, Numbers](), dict[Key, str]()
    for k, cell in enumerate(cells):
        for name in cell.techniques:
            key = (name, cell.motion, cell.sensors, cell.target)
            if (k, name, 0) in found:
                numbers[key] = found[k, name, 0][name]
                continue
            drawn = [found[k, "", number][name] for number in range(trials)]
            numbers[key] = found[k, "", -1][name] | _summary(drawn)
            if failed := [each["problem"] for each in drawn if each["problem"]]:
                problems[key] = failed[0]
    return TechniqueComparison(records, cells, numbers, problems, trials, seed)


def _summary(drawn: Sequence[Numbers]) -> Numbers:
    """Return the numbers of a technique in a cell from those of all trials."""
    errors = np.array([each["error"] for each in drawn])
    good = errors[np.isfinite(errors)]
    low = high = np.nan
    if good.size > 1:
        resampled = np.random.default_rng(0).choice(good, (1000, good.size))
        low, high = np.quantile(np.sqrt(np.mean(resampled**2, axis=1)), [0.025, 0.975])
    return {
        "rms": float(np.sqrt(np.mean(good**2))) if good.size else np.nan,
        "low": float(low),
        "high": float(high),
        "trials": float(len(errors)),
        "estimates": float(good.size),
        "seconds": float(np.median([each["seconds"] for each in drawn])),
    }


def _cells(
    scenarios: Mapping[str, Scenario], records: Sequence[Technique], seed: int
) -> list[Cell]:
    """Return the cells of scenarios that the techniques can share."""
    estimators = tuple(each.name for each in records if each.experiment is None)
    own = tuple(each.name for each in records if each.experiment and each.name != PLANAR)
    cells = []
    for number, (name, scenario) in enumerate(scenarios.items()):
        spacecraft, bodies = scenario.spacecraft.make(), scenario.body_uncertainty()
        _require_usable(scenario, spacecraft)
        motions = {name: scenario.make_joint_motion(spacecraft)}
        if number == 0:
            motions[ONE_JOINT] = one_joint.best_moves(spacecraft)
        targets = {SCENARIO: scenario.target_truth(), GENERIC: WITHOUT_SYMMETRY}
        for motion, target, sensors in product(motions, targets, SUITES):
            is_first = sensors == SUITES[0] and bodies is None
            if target == GENERIC and not is_first:
                continue
            names = tuple(each for each in estimators if each != ONLINE)
            if is_first and target == SCENARIO:
                names = (*estimators, *own)
            if motion == ONE_JOINT:
                names = (PLANAR,) if target == GENERIC else (FIT, PLANAR) if is_first else (FIT,)
            suite = load_sensors(sensors, unstated="exact")
            made = make_case(scenario, spacecraft, targets[target], suite, seed)
            moving = motions[motion]
            length = moving.duration if motion == ONE_JOINT else made.duration
            case = replace(made, motion=moving, duration=length, momentum=TotalMomentum.zero())
            truth = Truth(scenario.spacecraft, case)
            cells.append(Cell(motion, sensors, target, truth, names))
    return cells


def _require_usable(scenario: Scenario, spacecraft: Spacecraft) -> None:
    """Refuse a scenario that the techniques cannot share."""
    if spacecraft.tree.normal_B is not None:
        raise InputError("the techniques are for a base that floats freely, not on a table")
    simulation = scenario.simulation
    forces = [simulation.momentum_W, *vars(simulation.disturbance).values()]
    if simulation.burns or any(np.any(each) for each in forces if each is not None):
        raise InputError("the techniques are compared without momentum, thrust and disturbances")
    limits = spacecraft.limits.efforts
    if not np.isfinite(limits).all():
        joint = spacecraft.joint_names[int(np.argmin(np.isfinite(limits)))]
        raise InputError(f"the full scale of joint torques needs an effort limit of '{joint}'")


def _worker(
    inputs: tuple[tuple[Cell, ...], ForceSensors],
) -> Callable[[Task], dict[str, dict[str, Any]]]:
    """Return the function that does one task."""
    # Drake warns that it does not enforce joint limits, which prescribed motions do not need.
    logging.getLogger("drake").setLevel(logging.ERROR)
    cells, records = inputs[0], {each.name: each for each in techniques(inputs[1])}

    def work(task: Task) -> dict[str, dict[str, Any]]:
        k, experiment, number = task
        truth, names = cells[k].truth, cells[k].techniques
        if (run := records[experiment].experiment if experiment else None) is not None:
            return {experiment: run(truth)}
        chosen = [records[name] for name in names if records[name].estimate is not None]
        if number < 0 or not chosen:
            return _exact(truth, chosen) if chosen else {}
        trial, found = truth.trial(number), dict[str, dict[str, Any]]()
        for each in chosen:
            start, error, problem = perf_counter(), np.nan, ""
            assert each.estimate is not None
            try:
                error = rows.worst_error(each.estimate(trial), truth.case.truth.to_vector())
                problem = "" if np.isfinite(error) else "some parameters are not identifiable"
            except (InputError, np.linalg.LinAlgError) as raised:
                problem = str(raised)
            seconds = perf_counter() - start
            found[each.name] = {"error": error, "seconds": seconds, "problem": problem}
        return found

    return work


def _exact(truth: Truth, chosen: Sequence[Technique]) -> dict[str, Numbers]:
    """Return each technique's error with exact data, its bound, and the instants that it needs."""
    parameters, momentum, found = truth.case.truth.to_vector(), truth.bound(), dict[str, Numbers]()
    trial = truth.exact_trial()
    for each in chosen:
        own = {"bound": momentum if each.bound == "momentum" else np.nan}
        if each.design is not None:
            own["exact"] = rows.worst_error(rows.estimate(each.design, trial), parameters)
            own["instants"] = float(rows.instants(each.design, trial))
        if each.design is not None and each.bound == "rows":
            own["bound"] = rows.bound(each.design, trial, parameters)
        found[each.name] = own
    return found
