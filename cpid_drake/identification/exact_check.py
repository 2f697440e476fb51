"""The check that no error that is held exact explains what looks like slow noise.

An error of the model that nobody declares, such as axes of a gyro or zeros of joints, leaves
residuals that change slowly, as the motion does; so does slow noise. But noise does not know how
the craft moves. Where slow noise was found although `unstated: exact` holds errors at zero, each of
these is an unknown for once, beside all others and given the noise, with the prior of what hardware
has. The evidence says whether it is zero.

Source: Kass and Raftery 1995, Bayes factors (2 ln B > 6 is strong evidence).
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.fit import prior_of
from cpid_drake.estimation.gaussian import Gaussian, places_of
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import roll
from cpid_drake.estimation.sweep import sweep
from cpid_drake.estimation.unknowns import Model
from cpid_drake.identification.checks import Check
from cpid_drake.identification.chosen_fit import ChosenFit
from cpid_drake.identification.effect_estimates import EffectEstimate
from cpid_drake.identification.words import label_of

STRONG = 6.0
"""−2 log(evidence) that an error must gain to be the cause: odds of twenty."""


def exact_checks(chosen: ChosenFit, opened: Callable[[], Model | None]) -> tuple[Check, ...]:
    """Return the check of errors that are held exact; none without slow noise, or without such.

    Args:
        chosen: a fit.
        opened: returns its unknowns and those that are held exact; None if there are none.

    """
    fit = chosen.fit
    slow = [(log, name) for log in fit.logs for name in log.noise.slow_places]
    if not slow or (wide := opened()) is None:
        return ()
    gaussian = _with_exact(chosen, replace(wide, rows=fit.model.rows))
    new = [name for name in gaussian.places if name not in fit.posterior.places]
    if not new:
        return ()
    given = gaussian.marginal(new)
    H, b = given.R.T @ given.R - np.eye(given.size), given.R.T @ given.z  # without their priors
    gains = {name: _gain(H[place, place], b[place]) for name, place in given.places.items()}
    name = max(gains, key=lambda each: gains[each])
    log, unknown = wide.unknowns_of(log.name for log in fit.logs)[name]
    place = given.places[name]
    # x = (H + 1)⁻¹ b, in units of the σ that is tried
    covariance = np.linalg.inv(H[place, place] + np.eye(unknown.size))
    error = wide.of_log(log).constants.errors.get(unknown.name)
    what = "a body, the place of a joint or the grasp is not as the model says"
    if error is not None:
        size, sigma = covariance @ b[place], np.sqrt(np.diag(covariance))
        what = EffectEstimate.of(error, size, sigma).describe()
    sensors = dict.fromkeys(label_of(sensor) for _, sensor in slow)
    sentence = (
        f"what looks like slow noise of the {' and of the '.join(sensors)} follows the motion as "
        f"an error that `unstated: exact` excludes: {what}; state what the hardware can have"
    )
    return (Check.of("errors held exact", sentence, gains[name], STRONG),)


def _gain(H: Array, b: Array) -> float:
    """Return by how much −2 log(evidence) falls with an error of unit prior and its rows."""
    # 2 log(evidence) = bᵀ(H + 1)⁻¹ b − log det(H + 1)
    precision = H + np.eye(len(b))
    return float(b @ np.linalg.solve(precision, b) - np.linalg.slogdet(precision)[1])


def _with_exact(chosen: ChosenFit, wide: Model) -> Gaussian:
    """Return what is known of all unknowns and of those that are held exact, about the values."""
    fit, names = chosen.fit, [log.name for log in chosen.fit.logs]
    values = wide.start(names) | fit.values
    gaussian = prior_of(wide, fit.logs, values)
    for log in fit.logs:
        opened = widened(log, fit.model.of_log(log.name), wide.of_log(log.name))
        rolled = roll(wide, opened, values)
        gaussian = gaussian.add(sweep(wide, opened, rolled, values, forward_only=True).gaussian)
    return chosen.given(gaussian)


def widened(log: LogState, model: Model, wide: Model) -> LogState:
    """Return a log with the walks and white forces of a wider model; new ones are zero."""
    own = {unknown.name: unknown.size for unknown in model.walking}
    new = {unknown.name: unknown.size for unknown in wide.walking}
    forces = [
        _renamed(state.forces, model.force_sizes(*ends), wide.force_sizes(*ends))
        for state in log.states
        for ends in [(state.block.start, state.block.end)]
    ]
    links = (replace(link, walk=_renamed(link.walk, own, new)) for link in log.links)
    return log.with_each(forces=forces).with_links(links)


def _renamed(values: Array, own: Mapping[str, int], new: Mapping[str, int]) -> Array:
    """Return values (n,) of entries of other names and sizes; those that are new are zero."""
    places = places_of(own)
    parts = [values[places[n]] if n in places else np.zeros(size) for n, size in new.items()]
    return np.concatenate([np.empty(0), *parts])
