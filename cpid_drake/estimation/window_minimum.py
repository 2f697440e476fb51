"""The minimum of χ² of a window over the target.

For one ψ, a sweep over the blocks finds the best values of everything else, and the square root of
information about ψ; χ² is then a function of ψ alone (variable projection, Golub & Pereyra 1973).
The Levenberg-Marquardt method minimizes it. Each step solves the damped equations over all rigid
bodies, in the log-Cholesky form of the pseudo-inertia (Rucker & Wensing 2022). For a target at the
limit of physical consistency, such as a flat plate, the maximum of the likelihood may lie beyond
that limit; therefore the last steps are free, which keeps the estimate unbiased and its intervals
valid. They change well-known combinations of ψ only, because free values of the others are fitted
to noise.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from cpid_drake.dynamics.parameterizations import LogCholesky
from cpid_drake.dynamics.plane import round_body
from cpid_drake.errors import InputError
from cpid_drake.estimation.block_equations import CURVED
from cpid_drake.estimation.block_state import BlockState, solution
from cpid_drake.estimation.least_squares import KNOWN
from cpid_drake.estimation.likelihood.priors import Prior
from cpid_drake.estimation.window_sweep import Sweep, WindowModels

NEAR = 4.0
"""χ² per degree of freedom from which on free steps converge."""

_LITTLE = 0.1  # a step that reduces the cost by a smaller share ends the constrained stage
_ROUGH = 1e-4  # error of χ² by curvature, as a share of it, far from the minimum
_STEP_TOLERANCE = 0.01  # size of a step in units of σ
_MOST_STEPS = 20
_DAMPING = 1e-6  # of the first step, and of the first one after a failed step
_LARGEST = 1.0  # of a step in each coordinate of the log-Cholesky form


@dataclass(frozen=True, eq=False)
class WindowFit:
    """The best fit to a window.

    Attributes:
        sweep: the sweep from whose ψ the last step was taken.
        converged: whether the iteration reached its solution.
        changed: number of the block in which the momentum has changed; −1 for none.

    """

    sweep: Sweep
    converged: bool
    changed: int = -1

    @property
    def psi(self) -> NDArray[np.float64]:
        """(10,) the solution."""
        return self.sweep.state.nominal.psi


def minimized(
    models: WindowModels, prior: Prior, psi: NDArray[np.float64], changed: int, again: bool = False
) -> WindowFit:
    """Return the minimum of χ² over ψ; for `again` see `fit_window`."""
    start = models.sweep(psi, changed) if again else _constrained(models, prior, psi, changed)
    return _freed(models, prior, start, changed)


def _constrained(
    models: WindowModels, prior: Prior, psi: NDArray[np.float64], changed: int
) -> Sweep:
    """Return the sweep at a rigid body near the minimum of χ² over all rigid bodies."""
    form = LogCholesky(np.abs(prior.psi))
    axis = models.solver.tree.plane_axis
    if axis >= 0:
        psi = round_body(psi, axis)
    point = form.from_psi(psi)
    sweep, damping = models.sweep(form.to_psi(point)[0], changed), _DAMPING
    for _ in range(_MOST_STEPS):
        before = sweep.cost
        if sweep.state.psi_misfit() < 1.0:
            break  # nothing is left to gain
        new_point = _damped_step(form, point, sweep.state, damping)
        try:
            psi = form.to_psi(new_point)[0]
            tolerance = max(CURVED, _ROUGH * sweep.cost)
            new = models.sweep(psi, changed, near=sweep, tolerance=tolerance)
        except (InputError, np.linalg.LinAlgError):
            new = None
        if new is not None and new.cost < before:
            point, sweep, damping = new_point, new, damping / 10
            gained = (before - sweep.cost) / sweep.cost
            if gained < (_LITTLE if sweep.misfit < NEAR else _LITTLE / 10):
                break
            continue
        damping = max(100 * damping, _DAMPING)
        if damping > 1e6:
            break
    return sweep


def _damped_step(
    form: LogCholesky, point: NDArray[np.float64], state: BlockState, damping: float
) -> NDArray[np.float64]:
    """Return the point (10,) of the rigid body that solves the damped equations of a state best.

    The equations are linear in ψ; the Levenberg-Marquardt method damps the change of ψ.

    Args:
        form: from points to rigid bodies.
        point: (10,) the present one; no coordinate changes by more than `_LARGEST`.
        state: what a sweep at the present point found.
        damping: 0 for the undamped equations; a large number keeps ψ as it is.

    Raises:
        numpy.linalg.LinAlgError: the samples contradict each other so much that numbers overflow.

    """
    R, z = state.psi_equations()
    damped = np.vstack([R, np.sqrt(damping) * np.diag(np.linalg.norm(R, axis=0))])
    rest, unit = np.append(z, np.zeros(10)), np.linalg.norm(z)
    if not (np.isfinite(damped).all() and np.isfinite(unit)):
        raise np.linalg.LinAlgError("nothing explains the samples")

    def misses(new: NDArray[np.float64]) -> NDArray[np.float64]:
        return (damped @ (form.to_psi(new)[0] - state.nominal.psi) - rest) / unit

    def by_new(new: NDArray[np.float64]) -> NDArray[np.float64]:
        return damped @ form.to_psi(new)[1] / unit

    found = least_squares(
        misses, point, by_new, (point - _LARGEST, point + _LARGEST), x_scale="jac", max_nfev=10
    )
    return np.asarray(found.x)


def _freed(models: WindowModels, prior: Prior, sweep: Sweep, changed: int) -> WindowFit:
    """Take Gauss-Newton steps in ψ itself, along its well-known combinations."""
    for _ in range(_MOST_STEPS):
        step = psi_step(sweep.state, prior)
        if step_size(sweep.state, step) < _STEP_TOLERANCE:
            return WindowFit(sweep, True, changed)
        try:
            new = models.sweep(sweep.state.nominal.psi + step, changed, near=sweep)
        except (InputError, np.linalg.LinAlgError):
            break
        # χ² is exact to the curvature that is tolerated.
        if not new.cost < sweep.cost * (1 + _ROUGH) + CURVED * len(new.fits):
            break
        sweep = new
    return WindowFit(sweep, False, changed)


def best_psi(state: BlockState, prior: Prior) -> NDArray[np.float64]:
    """Return the best ψ (10,) by the equations of a state.

    Undetermined combinations keep their nominal values, because others are fitted to noise.
    """
    R, z = state.root[-10:, -10:], state.rest[-10:]
    return np.asarray(state.nominal.psi + solution(R, z, prior.plausible, KNOWN))


def psi_step(state: BlockState, prior: Prior) -> NDArray[np.float64]:
    """Return the step (10,) of the nominal ψ to the solution, along well-known combinations."""
    state = state.with_estimated_bodies()
    return solution(state.root[-10:, -10:], state.rest[-10:], prior.plausible)


def step_size(state: BlockState, step: NDArray[np.float64]) -> float:
    """Return the length of a step (10,) of ψ in units of σ, to which the known bodies add."""
    R, _ = state.psi_equations()
    return float(np.linalg.norm(R @ step))
