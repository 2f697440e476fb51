"""Fit of the target to a window of blocks, from a vague prior: maximum likelihood.

For one ψ, a sweep over the blocks finds the best values of everything else, and the square root of
information about ψ; χ² is then a function of ψ alone (variable projection, Golub & Pereyra 1973).
The Levenberg-Marquardt method minimizes it. Each step solves the damped equations over all rigid
bodies, in the log-Cholesky form of the pseudo-inertia (Rucker & Wensing 2022). For a target at the
limit of physical consistency, such as a flat plate, the maximum of the likelihood may lie beyond
that limit; therefore the last steps are free, which keeps the estimate unbiased and its intervals
valid. They change well-known combinations of ψ only, because free values of the others are fitted
to noise.
"""

from collections import Counter
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from cpid_drake.dynamics.parameterizations import LogCholesky
from cpid_drake.dynamics.plane import round_body
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.errors import InputError
from cpid_drake.estimation.block_equations import CURVED
from cpid_drake.estimation.block_state import BlockFit, BlockState, solution
from cpid_drake.estimation.blocks import BlockSolver
from cpid_drake.estimation.faults import (
    FEW,
    SPIKE,
    Block,
    Explained,
    block_model,
    bridged,
    explain,
)
from cpid_drake.estimation.initial_state import initial_state
from cpid_drake.estimation.least_squares import KNOWN
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.estimation.likelihood.priors import Prior
from cpid_drake.estimation.whiteness import whiteness
from cpid_drake.sensing.measurements import Measurements

WELL_KNOWN = 0.001
"""RMS relative error of the system's inertia at which blocks can be solved one after the other."""

_LITTLE = 0.1  # a step that reduces the cost by a smaller share ends the constrained stage
_NEAR = 4.0  # χ² per degree of freedom from which on free steps converge
_ROUGH = 1e-4  # error of χ² by curvature, as a share of it, far from the minimum
_STEP_TOLERANCE = 0.01  # size of a step in units of σ
_MOST_STEPS = 20
_FEWER_STEPS = 10  # near an estimate of the constant errors
_MOST_ROUNDS = 4  # of leaving out outliers
_UNEVEN = 3.0  # ratio of χ² per degree of freedom of two blocks that larger noise explains
_WHITE = 0.2  # correlation of successive residuals that larger noise explains
_DAMPING = 1e-6  # of the first step, and of the first one after a failed step
_LARGEST = 1.0  # of a step in each coordinate of the log-Cholesky form


@dataclass(frozen=True, eq=False)
class Sweep:
    """All blocks of a window at one ψ.

    Attributes:
        state: what is known at the end, at this nominal ψ.
        fits: of the blocks.
        bridged: start and end of the pieces that were bridged [s].
        left_out: number of samples left out, by sensor.

    """

    state: BlockState
    fits: tuple[BlockFit, ...]
    bridged: tuple[tuple[float, float], ...] = ()
    left_out: tuple[tuple[str, int], ...] = ()

    @property
    def cost(self) -> float:
        """χ² of all samples and of the prior at this ψ."""
        return sum(fit.chi_squared for fit in self.fits) + self.state.psi_misfit()

    @property
    def is_likely(self) -> bool:
        """Whether noise explains every block."""
        return all(fit.is_likely for fit in self.fits)

    @property
    def misfit(self) -> float:
        """χ² per degree of freedom."""
        return self.cost / max(sum(fit.freedom for fit in self.fits), 1)


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

    @property
    def is_good(self) -> bool:
        """Whether the iteration reached a solution from which noise explains every block."""
        return self.converged and self.sweep.is_likely


def best_psi(state: BlockState, prior: Prior) -> NDArray[np.float64]:
    """Return the best ψ (10,) by the equations of a state.

    Undetermined combinations keep their nominal values, because others are fitted to noise.
    """
    R, z = state.root[-10:, -10:], state.rest[-10:]
    return np.asarray(state.nominal.psi + solution(R, z, prior.plausible, KNOWN))


def fit_window(
    solver: BlockSolver,
    prior: Prior,
    blocks: Sequence[Block],
    psi: NDArray[np.float64],
    *,
    changed: int = -1,
    suspects: Sequence[int] = (),
    plain: bool = False,
    constants: NDArray[np.float64] | None = None,
) -> WindowFit:
    """Fit the target to successive blocks.

    Args:
        solver: solves blocks.
        prior: what is known before the first block.
        blocks: the samples.
        psi: (10,) relative unknowns of a rigid body, at which the fit starts.
        changed: number of the block in which the momentum has changed; −1 for none.
        suspects: numbers of the blocks in which it may have changed, too.
        plain: whether to use all samples, even if noise does not explain them.
        constants: see `initial_state`.

    Raises:
        InputError: the readings cannot be predicted even at the starting point.

    """
    left_out: Counter[str] = Counter()
    for _ in range(_MOST_ROUNDS):
        models = _Models(solver, prior, blocks, constants)
        found = _minimized(models, prior, psi, changed)
        found = replace(found, sweep=replace(found.sweep, left_out=tuple(left_out.items())))
        if plain or found.sweep.is_likely:
            return found
        blocks, out = _without_outliers(blocks, found)
        if not out:
            break
        left_out += out
    if _is_white(found.sweep):
        return found
    return _with_change(models, prior, found, suspects)


def _without_outliers(
    blocks: Sequence[Block], found: WindowFit
) -> tuple[list[Block], Counter[str]]:
    """Return the blocks without a few samples that are far off, and the number of these."""
    fits = iter(found.sweep.fits)
    result, out = [], Counter[str]()
    for k, block in enumerate(blocks):
        if k == found.changed:
            result.append(block)
            continue
        kept = dict(block.samples.samples)
        for name, rest in next(fits).residuals.items():
            size = np.sqrt(np.mean(rest**2, axis=1))
            far = size > SPIKE * max(1.0, 1.5 * np.median(size))
            if far.any() and far.sum() <= max(1.0, FEW * len(far)):
                kept[name] = kept[name].where(~far)
                out[name] += int(far.sum())
        samples = Measurements(block.samples.joint_names, kept)
        result.append(replace(block, samples=samples))
    return result, out


class _Models:
    """The likelihoods of successive blocks, prepared once for many sweeps."""

    def __init__(
        self,
        solver: BlockSolver,
        prior: Prior,
        blocks: Sequence[Block],
        constants: NDArray[np.float64] | None = None,
    ) -> None:
        self.solver, self.prior, self.blocks, self.constants = solver, prior, blocks, constants
        self.has_estimate = constants is not None and bool(constants.any())
        self._models: list[BlockModel] = []
        state = initial_state(solver, prior, prior.psi, blocks[0], constants)
        track = None
        for block in blocks:
            model = block_model(solver, replace(state, track=track), block)
            self._models.append(model)
            track = model.motion.joints.track

    @property
    def about_constants(self) -> "_Models":
        """The same likelihoods, linearized about the given values of the constant errors."""
        result = copy(self)
        result.solver = replace(self.solver, is_about_constants=True)
        return result

    def sweep(
        self, psi: NDArray[np.float64], changed: int = -1, tolerance: float = CURVED
    ) -> Sweep:
        """Return the sweep at ψ; the block number `changed` is bridged.

        For `tolerance` see `BlockSolver.solve`.
        """
        state = initial_state(self.solver, self.prior, psi, self.blocks[0], self.constants)
        fits: list[BlockFit] = []
        pieces: tuple[tuple[float, float], ...] = ()
        for k, model in enumerate(self._models):
            if k == changed:
                state = bridged(self.solver, self.prior, state, model, None)
                pieces = ((self.blocks[k].start, self.blocks[k].end),)
                continue
            fits.append(self.solver.solve(state, model, tolerance=tolerance))
            state = fits[-1].state
        return Sweep(state, tuple(fits), pieces)


def _minimized(
    models: _Models, prior: Prior, psi: NDArray[np.float64], changed: int = -1
) -> WindowFit:
    """Return the minimum of χ² over ψ.

    Without an estimate of the constant errors, each block is linearized about its own.
    """
    if models.has_estimate:
        about = models.about_constants
        fit = _freed(about, prior, _constrained(about, prior, psi, changed), changed)
        if fit.is_good:
            return fit
    return _freed(models, prior, _constrained(models, prior, psi, changed), changed)


def _constrained(models: _Models, prior: Prior, psi: NDArray[np.float64], changed: int) -> Sweep:
    """Return the sweep at a rigid body near the minimum of χ² over all rigid bodies."""
    form = LogCholesky(np.abs(prior.psi))
    axis = models.solver.tree.plane_axis
    if axis >= 0:
        psi = round_body(psi, axis)
    point = form.from_psi(psi)
    sweep, damping = models.sweep(form.to_psi(point)[0], changed), _DAMPING
    most = _FEWER_STEPS if models.solver.is_about_constants else _MOST_STEPS
    for _ in range(most):
        before = sweep.cost
        if sweep.state.psi_misfit() < 1.0:
            break  # nothing is left to gain
        new_point = _damped_step(form, point, sweep.state, damping)
        try:
            psi = form.to_psi(new_point)[0]
            new = models.sweep(psi, changed, max(CURVED, _ROUGH * sweep.cost))
        except (InputError, np.linalg.LinAlgError):
            new = None
        if new is not None and new.cost < before:
            point, sweep, damping = new_point, new, damping / 10
            gained = (before - sweep.cost) / sweep.cost
            if gained < (_LITTLE if sweep.misfit < _NEAR else _LITTLE / 10):
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
    R, z = state.root[-10:, -10:], state.rest[-10:]
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


def _freed(models: _Models, prior: Prior, sweep: Sweep, changed: int) -> WindowFit:
    """Take Gauss-Newton steps in ψ itself, along its well-known combinations."""
    for _ in range(_MOST_STEPS):
        step = psi_step(sweep.state, prior)
        if np.linalg.norm(sweep.state.root[-10:, -10:] @ step) < _STEP_TOLERANCE:
            return WindowFit(sweep, True, changed)
        try:
            new = models.sweep(sweep.state.nominal.psi + step, changed)
        except (InputError, np.linalg.LinAlgError):
            break
        if not new.cost < sweep.cost * (1 + 1e-6) + 1e-3:
            break
        sweep = new
    return WindowFit(sweep, False, changed)


def psi_step(state: BlockState, prior: Prior) -> NDArray[np.float64]:
    """Return the step (10,) of the nominal ψ to the solution, along well-known combinations."""
    state = state.with_estimated_bodies()
    return solution(state.root[-10:, -10:], state.rest[-10:], prior.plausible)


def _with_change(
    models: _Models, prior: Prior, plain: WindowFit, suspects: Sequence[int]
) -> WindowFit:
    """Return the fit with a change of momentum in one of some blocks; the plain one if none is.

    The plain one is good enough if its misfit is small, which the intervals then include.
    """
    options = []
    for k in suspects:
        try:
            options.append(_minimized(models, prior, prior.psi, k))
        except (InputError, np.linalg.LinAlgError):
            continue
    best = min((o for o in options if o.sweep.is_likely), key=lambda o: o.sweep.cost, default=None)
    is_near = plain.converged and plain.sweep.misfit < _NEAR
    return best or replace(plain, converged=is_near)


def _is_white(sweep: Sweep) -> bool:
    """Return whether larger noise than given explains a large χ².

    Then χ² is large in every block, and the residuals of every sensor are as large as a rule, not
    only because of outliers, and hardly correlated.
    """
    ratios = [fit.chi_squared / max(fit.freedom, 1) for fit in sweep.fits]
    if min(ratios) < max(ratios) / _UNEVEN:
        return False
    for name in sweep.fits[0].residuals:
        rest = np.concatenate([fit.residuals[name] for fit in sweep.fits if name in fit.residuals])
        white = whiteness(rest)
        size = np.median(np.abs(rest)) / 0.6745  # σ of a normal distribution
        if size < np.sqrt(np.mean(rest**2)) / 2:
            return False
        if abs(white.lag_one) > max(white.band, _WHITE):
            return False
    return True


def explained_sweep(
    solver: BlockSolver,
    prior: Prior,
    blocks: Sequence[Block],
    psi: NDArray[np.float64],
    constants: NDArray[np.float64] | None = None,
) -> Sweep:
    """Return the sweep at ψ, with outliers left out and changes of momentum bridged.

    For `constants` see `initial_state`.
    """
    whole = Explained(initial_state(solver, prior, psi, blocks[0], constants))
    for block in blocks:
        whole = whole.then(explain(solver, prior, whole.state, block))
    return Sweep(whole.state, whole.fits, whole.bridged, whole.left_out)


def inertia_uncertainty(state: BlockState, solver: BlockSolver) -> float:
    """Return the RMS relative error of the system's inertia J that the information about ψ means.

    J is that of the joint positions at the end; the error is infinite if these are not known.
    """
    if state.track is None:  # the last block was skipped
        return np.inf
    q = state.track.mean[:1]
    dynamics = relative_dynamics(solver.tree, q, np.zeros_like(q))
    J, zero = dynamics.inertia(state.nominal.psi)[0], dynamics.inertia(np.zeros(10))[0]
    if dynamics.normal_B is None:
        values, axes = np.linalg.eigh(J)
        W = axes / np.sqrt(np.maximum(values, 1e-9 * values[-1]))
    else:
        n = dynamics.normal_B[:, None]
        W = n / np.sqrt(n.T @ J @ n)
    by_psi = np.stack([W.T @ (dynamics.inertia(unit)[0] - zero) @ W for unit in np.eye(10)])
    spread = solve_triangular(state.root[-10:, -10:], by_psi.reshape(10, -1), trans="T")
    return float(np.sqrt(np.sum(spread**2) / W.shape[1]))
