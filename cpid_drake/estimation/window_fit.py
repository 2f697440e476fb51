"""Fit of the target to a window of blocks, from a vague prior: maximum likelihood.

Outliers are left out, and a change of momentum within one block is found, until noise explains all
blocks.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.errors import InputError
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.block_state import BlockState
from cpid_drake.estimation.blocks import BlockSolver
from cpid_drake.estimation.faults import FEW, SPIKE
from cpid_drake.estimation.likelihood.priors import Prior
from cpid_drake.estimation.whiteness import whiteness
from cpid_drake.estimation.window_minimum import NEAR, WindowFit, minimized
from cpid_drake.estimation.window_sweep import Sweep, WindowModels, Work
from cpid_drake.sensing.measurements import Measurements

WELL_KNOWN = 0.001
"""RMS relative error of the system's inertia at which blocks can be solved one after the other."""

_MOST_ROUNDS = 4  # of leaving out outliers
_UNEVEN = 3.0  # ratio of χ² per degree of freedom of two blocks that larger noise explains
_WHITE = 0.2  # correlation of successive residuals that larger noise explains


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
    again: bool = False,
    work: Work | None = None,
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
        again: whether ψ is the solution about other values of the constant errors.
        work: to which the block solutions are added; default: there is no limit.

    Raises:
        InputError: the readings cannot be predicted even at the starting point.
        WorkLimitError: see `work`.

    """
    left_out: Counter[str] = Counter()
    for _ in range(_MOST_ROUNDS):
        models = WindowModels(solver, prior, blocks, constants, work)
        found = minimized(models, prior, psi, changed, again)
        found = replace(found, sweep=replace(found.sweep, left_out=tuple(left_out.items())))
        if plain or found.sweep.is_likely:
            return found
        blocks, out = _without_outliers(blocks, found)
        if not out:
            break
        left_out += out
    if _is_white(found.sweep):
        return found
    return _with_change(models, prior, psi, found, suspects)


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


def _with_change(
    models: WindowModels,
    prior: Prior,
    psi: NDArray[np.float64],
    plain: WindowFit,
    suspects: Sequence[int],
) -> WindowFit:
    """Return the first fit with a change of momentum in one block that noise explains.

    If there is none, the plain one is good enough if its misfit is small, which the intervals then
    include.
    """
    for k in suspects:
        try:
            found = minimized(models, prior, psi, k)
        except (InputError, np.linalg.LinAlgError):
            continue
        if found.sweep.is_likely:
            return found
    return replace(plain, converged=plain.converged and plain.sweep.misfit < NEAR)


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
    spread = np.linalg.solve(state.psi_equations()[0].T, by_psi.reshape(10, -1))
    return float(np.sqrt(np.sum(spread**2) / W.shape[1]))
