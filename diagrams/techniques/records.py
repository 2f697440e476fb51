"""The techniques that are compared. A new one needs its record here."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cpid_drake import InputError, TotalMomentum, identify
from techniques import experiments, rows
from techniques.force_sensors import ForceSensors
from techniques.forgetting import forgetting_estimate
from techniques.rows import Design
from techniques.trial import Trial, Truth

FIT, ONLINE = "momentum, trajectory fit", "momentum, recursive fit"
"""The fits, in batch and online."""

PLANAR = "one joint at a time, planar"
"""The relations that take the motion of two bodies as planar."""


Experiment = Callable[[Truth], dict[str, float]]
"""Returns numbers by name."""


@dataclass(frozen=True)
class Technique:
    """A record of a technique, which has an `estimate`, a `design` or an `experiment`.

    Attributes:
        name: in tables.
        reference: where it is from.
        measures: what it needs besides attitude, gyro and encoders; empty for nothing.
        estimate: its function, which returns the parameters (10,). It raises an `InputError` if
            the trial lacks something.
        design: its rows, if it is least squares on rows of smoothed motion. They are exact with
            exact data; other techniques filter samples.
        bound: "momentum", the bound of its likelihood, or "rows", that of the design for an exact
            motion; empty for none.
        experiment: its function, if it has a motion, a training or a
            simulation of its own.
        is_slow: whether a fast run leaves it out.

    """

    name: str
    reference: str
    measures: str = ""
    estimate: Callable[[Trial], NDArray[np.float64]] | None = None
    design: Design | None = None
    bound: str = "momentum"
    experiment: Experiment | None = None
    is_slow: bool = False


def techniques(sensors: ForceSensors) -> tuple[Technique, ...]:
    """Return all techniques, with these sensors of forces."""
    ning, murotsu, sharf = "Ning et al. 2016", "Murotsu et al. 1993", "Nguyen-Huynh and Sharf 2013"
    slotine, ours, by_rows = "Slotine and Li 1987, 1989", "this package", rows.momentum_design
    any_momentum = by_rows("standard", is_unknown=True)
    measured = rows.accelerometer(sensors.accelerometer)
    found = [
        _of("momentum, the paper's rows", ning, "position", by_rows("eq18")),
        _of("momentum, standard rows", ning, "position", by_rows("standard")),
        _of("momentum, standard rows, any momentum", ours, "position", any_momentum, ""),
        _of("angular momentum, relative rows", "Yoshida and Abiko 2002", "", by_rows("relative")),
        Technique(FIT, ours, "", partial(_identified, "trajectory_fit")),
        Technique(ONLINE, ours, "", partial(_identified, "recursive_fit")),
        _of("accelerations, relative", murotsu, "", rows.accelerations),
        _of("accelerations, naive", murotsu, "position", rows.naive_accelerations, ""),
        _of("accelerations, accelerometer", murotsu, "position, accelerometer", measured, ""),
    ]
    for share in sensors.joint_torques:
        name, design = f"joint torques, {100 * share:g} % of full scale", rows.joint_torques(share)
        found.append(_of(name, "Rackl et al. 2013", "torque sensors", design, "rows"))
    for size in sensors.calibrations:
        for is_estimated in (False, True) if size else (False,):
            word = "estimated" if is_estimated else "ignored"
            name = f"wrist sensor, {100 * size:g} % {word}" if size else "wrist sensor, perfect"
            design = rows.wrist(sensors, size, is_estimated=is_estimated)
            found.append(_of(name, "Atkeson et al. 1986", "wrist sensor", design, "rows"))
    for name, memory in (("no forgetting", np.inf), ("memory 1 s", 1.0), ("memory 0.33 s", 0.33)):
        estimate = partial(forgetting_estimate, memory=memory)
        found.append(Technique(f"recursive least squares, {name}", sharf, "", estimate))
    own = experiments
    runs: list[tuple[str, str, str, Experiment]] = [
        (f"reactionless motion, {arms}", sharf, "", partial(own.reactionless, arms))
        for arms in own.ARMS
    ]
    runs += [
        (PLANAR, murotsu, "position", own.planar),
        ("momentum, only some joints move", ning, "", own.some_joints),
        ("the paper's Table 1, simulated", ning, "", own.resimulated),
        ("adaptive control", slotine, "base twist", partial(own.adaptive, False)),
        ("adaptive control, composite", slotine, "base twist", partial(own.adaptive, True)),
        ("neural network", "Ning et al. 2016, reference 6", "", own.network_errors),
    ]
    for name, reference, measures, run in runs:
        is_slow = name.startswith(("adaptive", "neural"))
        found.append(Technique(name, reference, measures, experiment=run, is_slow=is_slow))
    return tuple(found)


def _of(
    name: str, reference: str, measures: str, design: Design, bound: str = "momentum"
) -> Technique:
    estimate = partial(rows.estimate, design)
    return Technique(name, reference, measures, estimate, design, bound)


def _identified(estimator: str, trial: Trial) -> NDArray[np.float64]:
    """Return the parameters by one of the package's estimators."""
    found = identify(
        trial.spacecraft,
        trial.log,
        estimator=estimator,
        sensors=trial.suite,
        momentum=TotalMomentum.zero(),
        known_bodies=trial.known_bodies,
    )
    if not found.converged:
        raise InputError(f"{estimator} did not converge")
    return found.parameters
