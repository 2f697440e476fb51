"""All techniques on the same motion, noise and targets, and the paper's claims about them."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import SCALE_LENGTH, parameter_scale
from cpid_drake.errors import InputError
from cpid_drake.processes import shared_work
from cpid_drake.scenario.schema import Scenario
from cpid_drake.sensors.presets import load_sensors
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.studies.techniques import network, one_joint
from cpid_drake.studies.techniques.adaptive import Adaptation
from cpid_drake.studies.techniques.extras import GENERIC, extra, names_of
from cpid_drake.studies.techniques.force_sensors import ForceSensors
from cpid_drake.studies.techniques.records import FIT, ONLINE, Technique, techniques
from cpid_drake.studies.techniques.rows import bound, worst_error
from cpid_drake.studies.techniques.trial import (
    Truth,
    draw_trial,
    exact_trial,
    require_usable,
    truth_of,
)
from cpid_drake.studies.trials import Case, bound_of, make_case

Array = NDArray[np.float64]

ONE_JOINT = "one joint after another"
"""The name of that motion."""


@dataclass(frozen=True, eq=False)
class Cell:
    """A motion, sensors and a target, with the techniques that get them; `case` has all inputs."""

    motion: str
    suite: str
    target: str
    case: Case
    names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Score:
    """One technique's errors in one cell, of the worst of ten parameters relative to the scale.

    Attributes:
        technique: its name.
        cell: the cell.
        exact: error with exact data.
        bound: the bound, NaN if there is none.
        errors: (T,) with noise, NaN where it failed.
        seconds: median computing time of an estimate, after smoothing.
        problem: the first failure.

    """

    technique: str
    cell: Cell
    exact: float
    bound: float
    errors: Array
    seconds: float
    problem: str = ""

    @property
    def rms(self) -> float:
        """RMS of the errors of the trials that gave an estimate."""
        good = self.errors[np.isfinite(self.errors)]
        return float(np.sqrt(np.mean(good**2))) if good.size else np.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the RMS, by resampling of the trials."""
        good = self.errors[np.isfinite(self.errors)]
        if good.size < 2:
            return np.nan, np.nan
        drawn = np.random.default_rng(0).choice(good, (1000, good.size))
        low, high = np.quantile(np.sqrt(np.mean(drawn**2, axis=1)), [0.025, 0.975])
        return float(low), float(high)


@dataclass(frozen=True, eq=False)
class Comparison:
    """The results of `run_comparison`."""

    techniques: tuple[Technique, ...]
    scores: tuple[Score, ...]
    extras: Mapping[str, Mapping[str, float]]
    runs: Mapping[str, Adaptation]
    trials: int
    seed: int
    is_fast: bool
    durations: Mapping[str, float] = field(default_factory=dict)

    def score(self, technique: str, motion: str, suite: str, target: str = "paper") -> Score | None:
        """Return one score, None if it was not run."""
        for each in self.scores:
            cell = each.cell
            if (each.technique, cell.motion, cell.suite, cell.target) == (
                technique,
                motion,
                suite,
                target,
            ):
                return each
        return None

    def error(self, technique: str, motion: str, suite: str, target: str = "paper") -> float:
        """Return an RMS error, NaN if it was not run."""
        found = self.score(technique, motion, suite, target)
        return np.nan if found is None else found.rms

    def number(self, extra: str, name: str) -> float:
        """Return a number of an extra, NaN if it was not run."""
        return self.extras.get(extra, {}).get(name, np.nan)


Task = tuple[str, int, int]
"""“extra” or “cell”, its number, and the number of the trial; −1 for exact data."""


@dataclass(frozen=True, eq=False)
class Plan:
    """What is run: the cells, the sensors of forces, and the extras by name."""

    cells: tuple[Cell, ...]
    sensors: ForceSensors
    extras: tuple[str, ...]
    trials: int
    steps: int


def run_comparison(
    scenarios: Mapping[str, Scenario],
    sensors: ForceSensors,
    *,
    trials: int = 20,
    seed: int = 2016,
    jobs: int = 1,
    is_fast: bool = False,
    steps: int = network.STEPS,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Comparison:
    """Compare the techniques.

    Each scenario is run with the first two of its sensor suites; with a target without symmetry in
    addition, if its spacecraft is known exactly; and once with one joint after another.

    Args:
        scenarios: by name; the first one's spacecraft makes the motions of the extras.
        sensors: the sensors of forces.
        trials: draws of the noise in each cell.
        seed: of all random numbers.
        jobs: number of processes.
        is_fast: whether to leave out the network and the adaptive control.
        steps: batches of the network's training.
        progress: called with the numbers of finished and of all tasks.

    Raises:
        InputError: a number is not positive, a sensor is overloaded, or a scenario has no gyro, a
            momentum, thrust, a table or joints without effort limits.

    """
    for name, value in (("trials", trials), ("jobs", jobs), ("seed", seed + 1)):
        if value < 1:
            raise InputError(f"{name} must be at least 1, not {value}")
    records = techniques(sensors)
    everything = tuple(each.name for each in records)
    offline = tuple(name for name in everything if name != ONLINE)  # the same fit: once a motion
    cells = list[Cell]()
    for number, (motion, scenario) in enumerate(scenarios.items()):
        spacecraft, truth = scenario.spacecraft.make(), scenario.target_truth()
        for k, preset in enumerate(scenario.accuracy.presets[:2]):
            suite = load_sensors(preset)
            case = make_case(scenario, spacecraft, truth, suite, (), seed)
            require_usable(case, spacecraft, preset)
            names = everything if k == 0 and case.known_bodies is None else offline
            cells.append(Cell(motion, preset, "paper", case, names))
            if k == 0 and case.known_bodies is None:
                generic = replace(case, truth=GENERIC)
                cells.append(Cell(motion, preset, "generic", generic, offline))
            if number == 0:
                moves = one_joint.best_moves(spacecraft)
                case = replace(case, motion=moves, duration=moves.duration)
                cells.append(Cell(ONE_JOINT, preset, "paper", case, (FIT,)))
    extras = names_of([cell.motion for cell in cells if cell.target == "generic"], is_fast)
    plan = Plan(tuple(cells), sensors, extras, trials, steps)
    tasks: list[Task] = [("cell", k, -1) for k in range(len(cells))]  # refuses what is overloaded
    tasks += [("extra", k, 0) for k in range(len(extras))]
    tasks += [("cell", k, number) for number in range(trials) for k in range(len(cells))]
    results = dict[Task, Any]()
    for task, result in zip(tasks, shared_work(_worker, plan, tasks, jobs)):
        results[task] = result
        progress(len(results), len(tasks))
    return assembled(plan, records, results, seed, is_fast)


def assembled(
    plan: Plan, records: tuple[Technique, ...], results: Mapping[Task, Any], seed: int, fast: bool
) -> Comparison:
    """Return the comparison of the results of all tasks."""
    cells, trials, scores = plan.cells, plan.trials, list[Score]()
    found = [results["extra", k, 0] for k in range(len(plan.extras))]
    for k, cell in enumerate(cells):
        exact, *drawn = (results["cell", k, number] for number in range(-1, trials))
        for name in cell.names:
            errors = np.array([each[name][0] for each in drawn])
            seconds = float(np.median([each[name][1] for each in drawn]))
            problem = next((each[name][2] for each in drawn if each[name][2]), "")
            scores.append(
                Score(name, cell, exact[name][0], exact[name][1], errors, seconds, problem)
            )
    return Comparison(
        records,
        tuple(scores),
        {each.name: each.numbers for each in found},
        {each.name: each.run for each in found if each.run is not None},
        trials,
        seed,
        fast,
        {cell.motion: cell.case.duration for cell in cells},
    )


def _worker(plan: Plan) -> Callable[[Task], Any]:
    """Return the function that does one task; a cell's truth is computed once in a process."""
    # Drake warns that it does not enforce joint limits, which prescribed motions do not need.
    logging.getLogger("drake").setLevel(logging.ERROR)

    @cache
    def prepared(k: int) -> tuple[Spacecraft, Truth]:
        spacecraft = plan.cells[k].case.spacecraft.make()
        return spacecraft, truth_of(plan.cells[k].case, spacecraft, spacecraft.tree)

    records = {each.name: each for each in techniques(plan.sensors)}

    def work(task: Task) -> Any:
        kind, k, number = task
        if kind == "extra":
            cases = {each.motion: each.case for each in reversed(plan.cells)}
            return extra(plan.extras[k], dict(reversed(cases.items())), plan.steps)
        cell, (spacecraft, truth) = plan.cells[k], prepared(k)
        chosen = [records[name] for name in cell.names]
        if number < 0:
            return _exact(cell, spacecraft, truth, plan.sensors, chosen)
        trial, parameters = (
            draw_trial(cell.case, spacecraft, truth, plan.sensors, number),
            cell.case.truth.to_vector(),
        )
        found = {}
        for each in chosen:
            start, error, problem = perf_counter(), np.nan, ""
            try:
                error = worst_error(each.estimate(trial), parameters)
                problem = "" if np.isfinite(error) else "some parameters are not determined"
            except (InputError, np.linalg.LinAlgError) as raised:
                problem = str(raised)
            found[each.name] = (error, perf_counter() - start, problem)
        return found

    return work


def _exact(
    cell: Cell,
    spacecraft: Spacecraft,
    truth: Truth,
    sensors: ForceSensors,
    chosen: Sequence[Technique],
) -> dict[str, tuple[float, float]]:
    """Return each technique's error with exact data and its bound."""
    parameters = cell.case.truth.to_vector()
    scale = parameter_scale(parameters, SCALE_LENGTH)
    trial = exact_trial(cell.case, spacecraft, truth, sensors)
    momentum = float((bound_of(cell.case, spacecraft, truth.ideal) / scale).max())
    found = {}
    for each in chosen:
        error, least = np.nan, momentum if each.has_bound else np.nan
        if each.uses_rates:
            error = worst_error(each.estimate(trial), parameters)
        if each.design is not None:
            least = float((bound(each.design, trial, parameters) / scale).max())
        found[each.name] = error, least
    return found
