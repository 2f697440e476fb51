"""The techniques that are compared on the same log. A new one needs its record here."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.identification.identify import identify
from cpid_drake.studies.techniques import rows
from cpid_drake.studies.techniques.force_sensors import ForceSensors
from cpid_drake.studies.techniques.forgetting import forgetting_estimate
from cpid_drake.studies.techniques.rows import Design
from cpid_drake.studies.techniques.trial import Trial

Array = NDArray[np.float64]

FIT, ONLINE = "trajectory_fit", "recursive_fit"
"""The fits; the first also identifies from the motion of one joint after another."""


@dataclass(frozen=True)
class Technique:
    """A record of a technique.

    Attributes:
        name: in the table of numbers.
        label: in reports.
        reference: where it is from.
        measures: what it needs besides attitude, gyro and encoders; empty for nothing.
        estimate: its function, which returns the parameters (10,). It raises an `InputError` if
            the trial lacks something.
        design: its rows, if their bound for an exact motion can be told from them; else its bound
            is that of the momentum's likelihood, or none.
        has_bound: whether it has one of the two.
        uses_rates: whether it reads `Trial.rates`, which are exact with exact data; else samples.

    """

    name: str
    label: str
    reference: str
    measures: str
    estimate: Callable[[Trial], Array]
    design: Design | None = None
    has_bound: bool = True
    uses_rates: bool = False


def _identified(name: str, trial: Trial) -> Array:
    """Return the parameters by one of the package's estimators."""
    found = identify(
        trial.spacecraft,
        trial.log,
        estimator=name,
        sensors=trial.suite,
        momentum=TotalMomentum.zero(),
        known_bodies=trial.known_bodies,
    )
    if not found.converged:
        raise InputError(f"{name} did not converge")
    return found.parameters


def _of_rows(
    name: str, label: str, reference: str, measures: str, design: Design, bound: str = "momentum"
) -> Technique:
    """Return a technique of rows, with the bound of momentum, of its own rows or with none."""
    own = design if bound == "rows" else None
    estimate = partial(rows.estimate, design)
    return Technique(name, label, reference, measures, estimate, own, bound != "none", True)


def techniques(sensors: ForceSensors) -> tuple[Technique, ...]:
    """Return the techniques that use a log as it is, with these sensors of forces."""
    momentum, position = rows.momentum_rows, "position"
    ning, yoshida = "Ning et al. 2016, Eq. 18", "Yoshida and Abiko 2002"
    murotsu, torque = "Murotsu et al. 1993", "Rackl et al. 2013"
    atkeson, sharf = "Atkeson et al. 1986", "Nguyen-Huynh and Sharf 2013"
    found = [
        _of_rows("eq18", "momentum, the paper's rows", ning, position, momentum("eq18")),
        _of_rows("standard", "momentum, standard rows", ning, position, momentum("standard")),
        _of_rows("relative", "angular momentum, relative rows", yoshida, "", momentum("relative")),
        Technique(FIT, "momentum, trajectory fit", "this package", "", partial(_identified, FIT)),
        Technique(
            ONLINE,
            "momentum, recursive fit (online)",
            "this package",
            "",
            partial(_identified, ONLINE),
        ),
        _of_rows("accelerations", "accelerations, relative form", murotsu, "", rows.accelerations),
        _of_rows(
            "accelerations_naive",
            "accelerations, naive form",
            murotsu,
            position,
            rows.naive_accelerations,
            bound="none",
        ),
        _of_rows(
            "accelerometer",
            "accelerations, naive form with accelerometer",
            murotsu,
            "position, accelerometer",
            rows.accelerometer,
            bound="none",
        ),
    ]
    for share in sensors.joint_torques:
        design, percent = rows.joint_torques(share), f"{100 * share:g} %"
        label = f"joint torques of {percent} FS, relative form"
        found.append(_of_rows(f"torques {percent}", label, torque, "torques", design, "rows"))
    for size in sensors.calibrations:
        percent = f"{100 * size:g} %"
        for is_estimated in (False, True) if size else (False,):
            word = "estimated" if is_estimated else "ignored" if size else "perfect"
            design = rows.wrist(size, is_estimated=is_estimated)
            label = (
                f"wrist sensor, calibration {percent} {word}" if size else "wrist sensor, perfect"
            )
            name = f"wrist {percent} {word}"
            found.append(_of_rows(name, label, atkeson, "wrist sensor", design, "rows"))
    for name, memory in (("rls", np.inf), ("rls 1 s", 1.0), ("rls 0.33 s", 0.33)):
        label = "RLS without forgetting" if name == "rls" else f"RLS with a memory of {name[4:]}"
        estimate = partial(forgetting_estimate, memory=memory)
        found.append(Technique(name, f"{label}, relative rows", sharf, "", estimate))
    return tuple(found)
