"""One chunk of a campaign: its trials simulated together, each identified, as a table of rows."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from time import process_time
from typing import Any

import numpy as np
import pyarrow as pa

from cpid_drake.array import Array
from cpid_drake.campaign.campaign_schema import CampaignPlan, ModelErrors, TrialScenario, plan_of
from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.rotations import exponentials
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.files.dumping import nulls
from cpid_drake.files.errors import InputError
from cpid_drake.files.one_thread import one_thread
from cpid_drake.identification.identify import identify
from cpid_drake.identification.result import Identification
from cpid_drake.logs.log import Log, Samples
from cpid_drake.sensors.presets import load_sensors
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.simulation.scenario import Scenario, SpacecraftConfig
from cpid_drake.simulation.simulation import make_simulation
from cpid_drake.simulation.trials import (
    Case,
    base_trajectory,
    bound_of,
    draws,
    make_case,
    seeds_of,
    true_motions,
)
from cpid_drake.spacecraft.spacecraft import Spacecraft

_BATCHED = ("target.", "target", "tumble_C", "simulation.momentum_W")

_REPEATED, _BOUND = 2, 3  # purposes of random numbers; `CampaignPlan.values` has 1

_ten = pa.list_(pa.float64())
_COLUMNS = {
    "trial": pa.int64(),
    "point": pa.int32(),
    "estimator": pa.string(),
    "error": pa.string(),
    "truth": _ten,
    "estimate": _ten,
    "sigma": _ten,
    "inside": pa.list_(pa.bool_()),
    "bound": _ten,
    "nees": pa.float64(),
    "known": pa.int32(),
    "passed": pa.bool_(),
    "failed_checks": pa.list_(pa.string()),
    "drake_position": pa.float64(),
    "drake_angle": pa.float64(),
    "drake_seconds": pa.float64(),
    "truth_seconds": pa.float64(),
    "identify_seconds": pa.float64(),
}


def schema_of(plan: CampaignPlan) -> pa.Schema:
    """Return the columns of a campaign: the same for every trial, then one for each axis.

    `truth`, `estimate`, `sigma` and `bound` are in the order of `PARAMETER_NAMES`, and null where
    not known; `inside` says whether the truth is in the 95 % intervals; `nees` is the squared error
    of the estimator's own unknowns in units of their covariance, on average `known`. A row with an
    `error` has no estimate. The columns `drake_...` compare with Drake's simulation: largest
    distance [m] and angle [rad] of the base. Axes of numbers are numbers, others JSON.
    """
    axes = plan.campaign.axes.items()
    kinds = {f"axis {key}": pa.float64() if a.is_number else pa.string() for key, a in axes}
    return pa.schema({**_COLUMNS, **kinds})


@dataclass(eq=False)
class _Job:
    """A trial that is ready to be simulated."""

    number: int
    trial: TrialScenario
    spacecraft: Spacecraft
    case: Case
    suite: SensorSuite | None


@one_thread
def run_chunk(text: str, first: int, last: int) -> pa.Table:
    """Return the rows of trials first, …, last − 1 of the campaign of a text.

    An error of a trial is in its row. The rows do not depend on the other trials of the chunk.
    """
    plan, rows, groups = plan_of(text), dict[int, list[dict[str, Any]]](), dict[str, list[_Job]]()
    for number in range(first, last):
        values = plan.values(number)
        try:
            key = json.dumps({k: v for k, v in values.items() if not k.startswith(_BATCHED)})
            groups.setdefault(key, []).append(_job(plan, number, values))
        except Exception as error:
            rows[number] = failed_rows(plan, number, error)
    for group in groups.values():
        for job, (data, seconds) in zip(group, _data(plan, group)):
            try:
                if isinstance(data, Exception):
                    raise data
                rows[job.number] = _rows(plan, job, data, seconds)
            except Exception as error:
                rows[job.number] = failed_rows(plan, job.number, error)
    return pa.Table.from_pylist([r for n in sorted(rows) for r in rows[n]], schema_of(plan))


def failed_rows(
    plan: CampaignPlan, number: int, error: BaseException | str
) -> list[dict[str, Any]]:
    """Return the rows of a trial that gave no estimate."""
    name = "" if isinstance(error, InputError | str) else f"{type(error).__name__}: "
    text = " ".join(f"{name}{error}".split())
    return [
        {**_common(plan, number), "estimator": each, "error": text}
        for each in plan.campaign.estimators
    ]


def _common(plan: CampaignPlan, number: int) -> dict[str, Any]:
    """Return the number of a trial, its point in the grids and the values of its axes."""
    values = plan.values(number)
    axes = {
        f"axis {key}": float(values[key]) if axis.is_number else json.dumps(values[key])
        for key, axis in plan.campaign.axes.items()
    }
    return {"trial": number, "point": number // plan.campaign.trials, **axes}


def _job(plan: CampaignPlan, number: int, values: dict[str, Any]) -> _Job:
    trial = plan.trial(values)
    spacecraft = _spacecraft(json.dumps(asdict(trial.spacecraft)))
    suite = trial.sensors.explicit or (trial.sensors.suite and _suite(trial.sensors.suite)) or None
    suite = None if suite is None else suite.exact()
    truth = trial.target_truth()
    case = make_case(trial, spacecraft, truth, suite or SensorSuite(), plan.campaign.seed)
    if trial.tumble_C.any():
        q = case.motion.evaluate(np.zeros(1))[:, 0]
        R_WC = forward_kinematics(spacecraft.tree.lumped, q, 0 * q)[1].R_WC[0]  # B is at W then
        L_W = R_WC @ truth.I_TTcm_C @ trial.tumble_C
        momentum_W = case.momentum_W + np.concatenate([L_W, np.zeros(3)])
        case = replace(case, momentum_W=momentum_W, momentum=TotalMomentum.unknown())
    return _Job(number, trial, spacecraft, case, suite)


@lru_cache(maxsize=4)
def _spacecraft(config: str) -> Spacecraft:
    """Return a spacecraft; each worker builds its plant once."""
    return SpacecraftConfig(**json.loads(config)).make()


@lru_cache(maxsize=32)
def _suite(name: str) -> SensorSuite:
    return load_sensors(name, unstated="exact")


# -- the truth -------------------------------------------------------------------------------------


def _data(plan: CampaignPlan, jobs: Sequence[_Job]) -> list[tuple[Log | Motion | Exception, float]]:
    """Return what the estimators read in trials that differ as `trials.draws` allows, and the time.

    The time is that of the processor for each trial [s].
    """
    start = process_time()
    try:
        if plan.campaign.engine == "drake":
            data = [_simulated(plan, job) for job in jobs]
        else:
            data = _propagated(jobs)
    except Exception as error:  # of one of them: alone, each has its own
        if len(jobs) == 1:
            return [(error, process_time() - start)]
        return [each for job in jobs for each in _data(plan, [job])]
    return [(each, (process_time() - start) / len(jobs)) for each in data]


def _propagated(jobs: Sequence[_Job]) -> list[Log | Motion]:
    job = jobs[0]
    tree, names = true_tree(job.spacecraft.tree, job.trial.errors), job.spacecraft.joint_names
    cases, numbers = [each.case for each in jobs], [each.number for each in jobs]
    if job.suite is None:
        return [*true_motions(cases, tree, names, numbers, _instants(job.trial))]
    logs = draws(cases, tree, names, numbers)
    return [with_sensor_errors(log, each.trial.errors) for log, each in zip(logs, jobs)]


def _instants(trial: TrialScenario) -> Array:
    """Return the times at which a trial without sensors is sampled: those of its identifier."""
    config, end = trial.identification, trial.simulation.duration
    return np.arange(config.offset, end + 1e-9, config.period)


def _simulated(plan: CampaignPlan, job: _Job) -> Log | Motion:
    """Return the samples of a trial from Drake's simulation of its Diagram."""
    simulation = make_simulation(_scenario(plan, job))
    if job.suite is None:
        return simulation.run_sampled(_instants(job.trial))[1]
    return with_sensor_errors(simulation.log(simulation.run()), job.trial.errors)


def replayed(plan: CampaignPlan, number: int) -> Scenario:
    """Return the scenario with which Drake simulates a trial: its target, momentum and noise."""
    return _scenario(plan, _job(plan, number, plan.values(number)))


def _scenario(plan: CampaignPlan, job: _Job) -> Scenario:
    trial = job.trial
    rows = trial.identification.rows or "standard"
    own = {each.name: getattr(trial, each.name) for each in fields(Scenario)}
    own["sensors"] = replace(trial.sensors, seed=seeds_of(plan.campaign.seed, job.number)[0])
    own["simulation"] = replace(trial.simulation, momentum_W=job.case.momentum_W)
    own["identification"] = replace(
        trial.identification, estimator="least_squares", rows=rows, prior=None
    )
    return Scenario(**own)


def true_tree(tree: KinematicTree, errors: ModelErrors) -> KinematicTree:
    """Return the true spacecraft of which a model has errors with given values."""
    scale = 1 + errors.mass
    bodies = tuple(
        replace(each, mass=scale * each.mass, I_BBcm=scale * each.I_BBcm) for each in tree.bodies
    )
    place = tree.p_BC + tree.R_BC @ (1e-3 * errors.grasp_mm)
    return replace(
        tree, bodies=bodies, p_BC=place, R_BC=tree.R_BC @ exponentials(1e-3 * errors.grasp_mrad)
    )


def with_sensor_errors(log: Log, errors: ModelErrors) -> Log:
    """Return a log with the errors of sensors that have given values."""
    changed = {}
    for name, samples in log.samples.items():
        late = 1e-3 * errors.delay_ms.get(name, 0.0)
        zero = 1e-3 * errors.joint_zero_mrad if name == "encoders" else 0.0
        if late or zero:
            changed[name] = Samples(samples.time + late, samples.value + zero)
    return log.updated(changed) if changed else log


def _compared(plan: CampaignPlan, job: _Job) -> dict[str, float]:
    """Return the largest differences of the base's pose between propagation and Drake.

    Of the nominal spacecraft, at 21 instants.
    """
    simulation = make_simulation(_scenario(plan, job))
    times, start = np.linspace(0.0, job.case.duration, 21), process_time()
    _, drake = simulation.run_sampled(times)
    seconds = process_time() - start
    seed = seeds_of(plan.campaign.seed, job.number)[0]
    tree = job.spacecraft.tree
    base = base_trajectory(job.case, tree, times, job.case.disturbance(seed))
    own = base.to_motion(job.spacecraft.joint_names, times, job.case.motion)
    turn = np.linalg.norm(np.swapaxes(own.R_WB, 1, 2) @ drake.R_WB - np.eye(3), axis=(1, 2))
    return {
        "drake_position": float(np.linalg.norm(own.p_WB - drake.p_WB, axis=1).max()),
        "drake_angle": float(turn.max() / np.sqrt(2)),  # of a small rotation
        "drake_seconds": seconds,
    }


# -- the estimates ---------------------------------------------------------------------------------


def _rows(
    plan: CampaignPlan, job: _Job, data: Log | Motion, seconds: float
) -> list[dict[str, Any]]:
    """Return the rows of a trial: one for each estimator."""
    case, campaign = job.case, plan.campaign
    common = {**_common(plan, job.number), "truth": nulls(case.truth.to_vector())}
    common["truth_seconds"] = seconds
    if isinstance(data, Log) and _is_drawn(plan, job.number, _BOUND, campaign.bounds):
        values = json.dumps(plan.values(job.number))
        common["bound"] = nulls(_bound(plan.text, values))
    repeats = campaign.engine == "propagator"
    if repeats and _is_drawn(plan, job.number, _REPEATED, campaign.repeated):
        common |= _compared(plan, job)
    declared, rows = _declared(job), []
    for name in campaign.estimators:
        row, start = {**common, "estimator": name}, process_time()
        try:
            answer = identify(job.spacecraft, data, estimator=name, **declared)
            row |= _estimate(answer, case.truth.to_vector())
        except Exception as error:
            [*_, row["error"]] = failed_rows(plan, job.number, error)[0].values()
        rows.append({**row, "identify_seconds": process_time() - start})
    return rows


def _is_drawn(plan: CampaignPlan, number: int, purpose: int, share: float) -> bool:
    """Return whether a trial is one of a share of all."""
    return bool(np.random.default_rng(plan.random(number, purpose)).random() < share)


def _declared(job: _Job) -> dict[str, Any]:
    """Return the arguments of the estimators besides the samples."""
    declared, case, sensors = job.trial.declared, job.case, job.suite
    if declared.sensors is not None:
        sensors = None if declared.sensors == "none" else _suite(declared.sensors)
    bodies = declared.known_bodies or case.known_bodies
    momentum = case.momentum
    if declared.momentum == "known":
        momentum = replace(case.total_momentum(job.spacecraft.tree), is_unknown=False)
    elif declared.momentum is not None:
        momentum = TotalMomentum(is_unknown=declared.momentum == "unknown")
    return {
        "sensors": sensors,
        "momentum": momentum,
        "known_bodies": None if bodies is None or bodies.is_zero else bodies,
    }


@lru_cache(maxsize=8)
def _bound(text: str, values: str) -> Array:
    """Return the Cramér-Rao bound (10,) on σ with these values of the axes, as JSON.

    Without an axis that is drawn, it is the same in all trials of a point.
    """
    job = _job(plan_of(text), 0, json.loads(values))
    return bound_of(job.case, job.spacecraft)


def _estimate(answer: Identification, truth: Array) -> dict[str, Any]:
    """Return what a row says of an identification."""
    if not answer.converged:
        return {"error": "did not converge"}
    if not answer.is_complete:
        return {"error": answer.explain()}
    error, sigma = answer.parameters - truth, np.sqrt(np.diag(answer.covariance))
    is_known = np.isfinite(error) & np.isfinite(sigma)
    low, high = answer.intervals.T
    assert answer.form is not None
    assert answer.solution is not None
    about_truth = answer.solution.determined.minus(answer.form.from_parameters(truth))
    inside = (low <= truth) & (truth <= high)
    return {
        "estimate": nulls(answer.parameters),
        "sigma": nulls(sigma),
        "inside": [bool(i) if k else None for i, k in zip(inside, is_known)],
        "nees": about_truth.cost(np.zeros(10)),
        "known": int(is_known.sum()),
        "passed": answer.passed,
        "failed_checks": [check.name for check in answer.checks if not check.passed],
    }
