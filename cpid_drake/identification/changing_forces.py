"""Forces and torques that change faster than their random walks, which nobody states.

Wheels that are not in the log, cables and drag change within a block. Where the steps of a random
walk are improbable, or a torque between blocks has evidence (`torque_check`), the fit has a white
force besides, of the plausible size in each of its pieces, and its process of the largest evidence;
see `estimation.noise`.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import partial

from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.fit import Fit
from cpid_drake.estimation.fit import fit as fit_logs
from cpid_drake.estimation.likelihood.constants import (
    ACCELERATION,
    ACCELERATION_B,
    TORQUE,
    TORQUE_B,
)
from cpid_drake.estimation.likelihood.forces import (
    ACCELERATION_NOISE,
    PIECE,
    SHORTEST_PIECE,
    TORQUE_NOISE,
)
from cpid_drake.estimation.log_state import LogState
from cpid_drake.identification.exact_check import STRONG, widened
from cpid_drake.identification.torque_check import torque_gains
from cpid_drake.identification.walk_check import walks_of
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.error_kinds import KINDS
from cpid_drake.sensors.suite import SensorSuite

_NOISE = {
    TORQUE: TORQUE_NOISE,
    TORQUE_B: TORQUE_NOISE,
    ACCELERATION: ACCELERATION_NOISE,
    ACCELERATION_B: ACCELERATION_NOISE,
}
"""Names of the white forces, by what walks."""

_PLAUSIBLE = {TORQUE_NOISE: (TORQUE, SHORTEST_PIECE), ACCELERATION_NOISE: (ACCELERATION, PIECE)}
"""Of which plausible size they are in how long a piece [s]."""


def with_changing_forces(
    fit: Fit, progress: Callable[[str], object]
) -> tuple[Fit, dict[str, float], str]:
    """Return a fit with white forces, its `torque_gains`, and a warning; or the same fit.

    They act where random walks are improbable, or a torque between blocks has evidence.

    Args:
        fit: a fit.
        progress: see `estimation.fit.fit`.

    """
    gains = torque_gains(fit)
    if all(_is_exact(fit, log) for log in fit.logs):
        return fit, gains, ""
    names = _acting(fit, gains)
    model = fit.model.with_suites(partial(_with_noise, tree=fit.model.tree, names=names))
    log_names = [log.name for log in fit.logs]
    if all(model.of_log(n).suite == fit.model.of_log(n).suite for n in log_names):
        return fit, gains, ""
    logs = [
        widened(log.with_noise(converged=False), fit.model.of_log(log.name), model.of_log(log.name))
        for log in fit.logs
    ]
    wide = fit_logs(model, logs, values=fit.values, progress=progress)
    left = torque_gains(wide)
    if not wide.converged or _acting(wide, left):
        return fit, gains, ""
    forces = " and ".join(sorted({name.partition("_")[0] for name in names}))
    warning = (
        f"the {forces} on the system changes faster than a random walk of its plausible size: "
        f"noise was assumed; state what acts as {' and '.join(sorted(names))}"
    )
    return wide, left, warning


def _acting(fit: Fit, gains: Mapping[str, float]) -> set[str]:
    """Return the names of white forces that act, or instead of which something walks too far.

    A log of which all that is not stated is exact gets none.
    """
    pairs = [(log, rolled) for log, rolled in zip(fit.logs, fit.rolled) if not _is_exact(fit, log)]
    fit = replace(fit, logs=[log for log, _ in pairs], rolled=[rolled for _, rolled in pairs])
    names = {
        _NOISE[each.name]
        for each in walks_of(fit)
        if each.name in _NOISE and each.square > each.limit
    }
    acts = any(gains[log.name] > STRONG for log, _ in pairs)
    return names | ({TORQUE_NOISE} if acts else set())


def _is_exact(fit: Fit, log: LogState) -> bool:
    """Return whether all that is not stated of a log's sensors and forces is exact."""
    return fit.model.of_log(log.name).suite.unstated == "exact"


def _with_noise(suite: SensorSuite, tree: KinematicTree, names: Collection[str]) -> SensorSuite:
    """Return a suite with white forces of plausible sizes, unless they are stated or exact."""
    forces = suite.disturbances or Disturbances()
    new = {}
    for name in names if suite.unstated != "exact" else ():
        if getattr(forces, name) is None:
            kind, piece = _PLAUSIBLE[name]
            new[name] = KINDS[kind].plausible(tree) * piece**0.5
    return replace(suite, disturbances=replace(forces, **new)) if new else suite
