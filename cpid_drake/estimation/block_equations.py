"""The linear equations of one block, and their solution by one QR factorization; see `blocks`."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cpid_drake.estimation.block_state import BlockFit, BlockState, solution
from cpid_drake.estimation.jumps import SIZE, Jump
from cpid_drake.estimation.likelihood.constants import FIXED, NOT_MOVED
from cpid_drake.estimation.likelihood.effects import GyroBias
from cpid_drake.estimation.likelihood.joint_block import JointBlock
from cpid_drake.estimation.likelihood.joint_motion import ORDER
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.estimation.likelihood.motion import Trajectory
from cpid_drake.estimation.square_root import triangle

if TYPE_CHECKING:
    from cpid_drake.estimation.blocks import BlockSolver

CURVED = 0.01
"""Change of χ² by curvature above which a block is linearized again."""


def at_nominal(
    solver: "BlockSolver", state: BlockState, model: BlockModel
) -> tuple[Trajectory, NDArray[np.float64]]:
    """Return a block's trajectory from the nominal values at its start.

    Args:
        solver: the solver of the block.
        state: at the start of the block.
        model: the likelihood of the block.

    Returns:
        The trajectory, and the difference (n,) of its unknowns from the nominal values.

    Raises:
        InputError: the motion cannot be predicted for these values.

    """
    nodes = [effect.nodes for effect in model.effects if isinstance(effect, GyroBias)]
    shift, constants = np.zeros(len(state.root)), state.nominal.constants.copy()
    for error in solver.constants.errors.values():
        if error.kind in NOT_MOVED:
            place = solver.constants.place(error.name)
            about = model.nominal[place] if error.kind in FIXED else 0.0
            shift[solver.places[error.name]] = about - constants[place]
            constants[place] = about
    first = replace(
        state.nominal, bias=np.repeat(state.nominal.bias, nodes, axis=0), constants=constants
    )
    if state.track is not None:
        moved = model.motion.joints.coefficients[:ORDER] - state.track.mean
        shift[solver.places["joints"]] = moved.T.ravel()
    return model.motion.trajectory(first), shift


class BlockEquations:
    """The equations of one block, linearized somewhere.

    The unknowns of the factorization are, in order: those that end with the block, those that the
    next block needs (with attitude and centre of mass at the end in place of the start), and the
    errors of the known bodies.
    """

    def __init__(
        self,
        solver: "BlockSolver",
        state: BlockState,
        model: BlockModel,
        weights: NDArray[np.float64] | None,
    ) -> None:
        self.solver, self.before, self.model = solver, state, model
        sensors = model.sensors.values()
        widths = np.concatenate([[], *(np.full(len(s.samples), s.width) for s in sensors)])
        self.weights = None if weights is None else np.repeat(weights, widths.astype(int))
        gone = np.setdiff1d(np.arange(model.size), model.at_end)
        self.order = np.concatenate([gone, model.at_end])
        self.kept = len(model.at_end)
        trajectory, self.shift = at_nominal(solver, state, model)
        self._linearize(trajectory)

    def _linearize(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self.residuals = self.model.residuals(trajectory)
        self.jacobian, self.end = self.model.jacobian(trajectory)
        self.transitions = self.model.transitions(trajectory)

    def solve(self, plausible: NDArray[np.float64] | None) -> None:
        """Factorize all rows, and compute the step of this block's unknowns."""
        model, before = self.model, self.before
        size, known = model.size, self.jacobian.shape[1]
        width = size + before.extra.shape[1] + 1
        links, rest = model.links(self.trajectory.state)
        n, m = len(before.root), len(rest)
        A = np.zeros((n + m + len(self.residuals), width))
        A[:n, model.at_start], A[:n, size:-1] = before.root, before.extra
        A[:n, -1] = before.rest - before.root @ self.shift
        A[n : n + m, :known], A[n : n + m, -1] = links, rest
        A[n + m :, :known], A[n + m :, -1] = self.jacobian, self.residuals
        if self.weights is not None:
            A[n + m :] *= self.weights[:, None]
        # Replace attitude, centre of mass and momentum at the start by those at the end.
        turned, end = model.turned, self.end
        by_end = A[:, turned] @ np.linalg.inv(end[:, turned])
        A[:, :known] -= by_end @ end
        A[:, turned] = by_end
        for column, by, factor in self.transitions:
            A[:, column] -= A[:, by] @ factor
        columns = np.concatenate([self.order, np.arange(size, width)])
        R = triangle(A[:, columns])
        self.R = R
        used = np.count_nonzero(np.diag(before.root)) + len(A) - n
        if self.weights is not None:
            used -= int((self.weights == 0).sum())
        self.freedom = int(used - size)
        y = np.zeros(known)
        held = self.solver.held_count
        y[self.order] = solution(R[:size, :size], R[:size, -1], plausible, held=held)
        step = y.copy()
        for column, by, factor in reversed(self.transitions):
            step[by] -= factor @ step[column]
        others = step.copy()
        others[turned] = 0.0
        step[turned] = np.linalg.solve(end[:, turned], step[turned] - end @ others)
        self.step = step[:size]
        self.step[model.held] = 0.0

    def relinearized(self, tolerance: float) -> bool:
        """Linearize at the solution, if this changes χ² by more than the tolerance; return that."""
        model = self.model
        step = self.step.copy()
        for name in self.solver.held:
            step[model.columns[name]] = 0.0
        state = model.moved(self.trajectory.state, step)
        trajectory = model.motion.trajectory(state, self.trajectory)
        off = model.residuals(trajectory) - (self.residuals - self.jacobian[:, : model.size] @ step)
        if self.weights is not None:
            off *= self.weights
        if off @ off < tolerance:
            return False
        self.shift += step[model.at_start]
        self._linearize(trajectory)
        return True

    def fit(self, plausible: NDArray[np.float64] | None) -> BlockFit:
        """Return the solution."""
        model, n = self.model, self.kept
        size, state = model.size, self.trajectory.state
        corner = self.R[size - n : size, size - n :]
        last = [e.rows.stop - 1 for e in model.effects if isinstance(e, GyroBias)]
        nominal = replace(model.motion.end(self.trajectory), bias=state.bias[last])
        joints = model.motion.joints
        assert isinstance(joints, JointBlock)
        bodies = n + self.before.by_bodies.shape[1]
        end = replace(
            self.before,
            time=joints.end,
            nominal=nominal,
            track=joints.track,
            root=corner[:, :n],
            by_bodies=corner[:, n:bodies],
            rest=corner[:, -1],
            bodies=self._about_bodies()[: bodies - n],
            jumps=self._jumps(corner[:, bodies:-1]),
        )
        rest = self.residuals - self.jacobian[:, :size] @ self.step
        sizes = np.cumsum([s.width * len(s.samples) for s in model.sensors.values()])
        parts = np.split(rest, sizes[:-1] if len(sizes) else [])
        residuals = {
            name: part.reshape(-1, sensor.width)
            for (name, sensor), part in zip(model.sensors.items(), parts)
        }
        times = {name: sensor.samples.time for name, sensor in model.sensors.items()}
        end = self.solver.settled(end, plausible)
        chi_squared, misfit = self._chi_squared(), self.solver.misfit
        return BlockFit(end, joints, residuals, times, chi_squared, self.freedom, misfit)

    def _left(self) -> NDArray[np.float64]:
        """Return the rows by known bodies, assumed changes and right-hand side that are left."""
        return self.R[self.model.size :, self.model.size :]

    def _jumps(self, columns: NDArray[np.float64]) -> tuple[Jump, ...]:
        """Return the assumed changes at the end, from their columns (n, 12 k)."""
        left, bodies = self._left(), np.arange(self.before.by_bodies.shape[1])
        jumps = []
        for k, jump in enumerate(self.before.jumps):
            own = np.arange(SIZE * k, SIZE * (k + 1))
            places = np.concatenate([bodies, len(bodies) + own, [left.shape[1] - 1]])
            jumps.append(jump.after(columns[:, own], left[:, places]))
        return tuple(jumps)

    def _chi_squared(self) -> float:
        """Return χ² of the block at the best errors of the known bodies."""
        return float(np.sum(self._about_bodies()[len(self.before.bodies) :, -1] ** 2))

    def _about_bodies(self) -> NDArray[np.float64]:
        """Return the triangle of all rows so far about the known bodies' errors alone."""
        left, bodies = self._left(), len(self.before.bodies)
        left = left[:, [*range(bodies), -1]]
        return triangle(np.vstack([self.before.bodies, left])) if bodies else left
