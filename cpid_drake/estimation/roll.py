"""Prediction of a log: the samples of all blocks at given values of all unknowns."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.estimation.likelihood.model import BlockModel, jump_between
from cpid_drake.estimation.likelihood.motion import BaseMotion, Trajectory, TrajectoryState, relate
from cpid_drake.estimation.likelihood.white_reading import WhiteReading
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.unknowns import BODIES, PSI, Model, psi_about

Values = dict[str, NDArray[np.float64]]
"""Present values of all unknowns of all logs, by name."""


_AIMED = 2  # Newton steps to a state: the first one leaves a miss of second order
_REACHED = 1e-3  # change of a white force that does not matter, in units of its σ


@dataclass(frozen=True, eq=False)
class Rolled:
    """A log, predicted at given values.

    Attributes:
        models, trajectories: of each block.
        residuals: of each block: (M, d) in units of the declared σ, by sensor.
        links: sum of squares of all rows inside of the log that are no samples of the base.
        start: sum of squares of what is known at its start.
        by_psi: (10, 10) derivative of ψ about the known bodies' present mass by the target's
            coordinates.

    """

    models: list[BlockModel]
    trajectories: list[Trajectory]
    residuals: list[dict[str, NDArray[np.float64]]]
    links: float
    start: float
    by_psi: NDArray[np.float64]

    def part(self, first: int, end: int) -> "Rolled":
        """Return the prediction of the blocks from `first` up to `end`."""
        return replace(
            self,
            models=self.models[first:end],
            trajectories=self.trajectories[first:end],
            residuals=self.residuals[first:end],
        )

    @property
    def count(self) -> int:
        """Number of all residuals."""
        return sum(rest.size for block in self.residuals for rest in block.values())

    def cost(self, log: LogState, step: Values | None = None) -> float:
        """Return the sum of squares of all rows of a log.

        Args:
            log: the log.
            step: of all unknowns since white torques were linear in the inertia.

        """
        return self.start + self.cost_inside(log, step)

    def cost_inside(self, log: LogState, step: Values | None = None) -> float:
        """Return the sum of squares of all rows of a log but those at its start; see `cost`."""
        total = self.links
        for k, block in enumerate(self.residuals):
            for name, rest in block.items():
                sensor = self.models[k].sensors[name]
                if step and isinstance(sensor, WhiteReading):
                    for effect, by in sensor.by_unknowns(self.trajectories[k]).items():
                        by = by @ self.by_psi if effect == PSI else by
                        rest = rest - by @ step[effect] if effect in step else rest
                total += float(np.sum(log.weighted(k, name, rest) ** 2))
        return total

    def all_residuals(self) -> dict[str, NDArray[np.float64]]:
        """Return the residuals of each sensor, block after block."""
        names = sorted({name for block in self.residuals for name in block})
        return {n: np.concatenate([b[n] for b in self.residuals if n in b]) for n in names}


def constants_of(model: Model, log: LogState, values: Values) -> NDArray[np.float64]:
    """Return the constants (k,) of a log; of those that walk, the last value."""
    parts = [values[u.key(log.name)] for u in model.table if u.name in model.constants.errors]
    return np.concatenate([np.empty(0), *parts])


def roll(model: Model, log: LogState, values: Values) -> Rolled:
    """Predict all samples of a log.

    White forces and changes between blocks follow from the states at which the log aims, as far as
    they can: otherwise what a step is wrong by in one block would grow in all that follow.

    Args:
        model: the unknowns.
        log: the log; its jumps and white forces become those that reach its aims.
        values: of the unknowns.

    Raises:
        InputError: no rigid body has these values.

    """
    tree = model.tree_with(values.get(BODIES))
    psi, by_psi = psi_about(values[PSI], model.mass, tree.mass)
    last = constants_of(model, log, values)
    walking, sigma = model.walking_columns, model.walking_sigma
    state, links = log.start, 0.0
    assert state is not None
    # of each block: what is still to come
    later = np.cumsum([np.zeros(len(walking)), *reversed(log.walks)], axis=0)[::-1]
    models, nominal, trajectories, residuals = list[BlockModel](), [], [], []
    for k, (block, joints) in enumerate(zip(log.blocks, log.joints, strict=True)):
        constants = last.copy()
        constants[walking] -= later[k]
        part = BlockModel(
            tree,
            joints,
            block.samples,
            model.suite,
            model.known_bodies,
            constants=model.constants,
            nominal=constants,
            errors=values.get(BODIES),
            origin=log.origin,
        )
        models.append(part)
        nominal.append(constants)
    relate([part.motion for part in models])
    for k, (part, block) in enumerate(zip(models, log.blocks, strict=True)):
        first = replace(state, psi=psi, constants=nominal[k], forces=log.forces[k])
        aim = log.aims.get(k + 1)
        trajectory = part.motion.trajectory(first)
        if aim is not None and k not in log.jumps and len(log.forces[k]):
            trajectory = _aimed(part.motion, trajectory, aim)
            log.forces[k][:] = trajectory.state.forces
        trajectories.append(trajectory)
        bent, moved = part.bent(trajectory)
        residuals.append(
            {n: s.residuals(trajectory) - bent.get(n, 0.0) for n, s in part.sensors.items()}
        )
        links += float(np.sum(part.motion.joints.rest**2))
        state = jumped(part.motion.end(trajectory), moved)
        if k < len(log.walks):
            links += float(np.sum((log.walks[k] / sigma) ** 2)) / block.length
        if k in log.jumps:
            if aim is not None:
                log.jumps[k] = jump_between(state, aim)
            state = jumped(state, log.jumps[k])
            links += float(np.sum((log.jumps[k] / model.farthest) ** 2))
    start = float(np.sum(first_values(model, log, values) ** 2))
    return Rolled(models, trajectories, residuals, links, start, by_psi)


def _aimed(motion: BaseMotion, trajectory: Trajectory, aim: TrajectoryState) -> Trajectory:
    """Return the trajectory with the smallest change of its white forces that ends at a state."""
    for _ in range(_AIMED):
        miss = jump_between(motion.end(trajectory), aim)
        change = np.linalg.lstsq(motion.end_by_white(trajectory), miss)[0]
        if np.abs(change).max() < _REACHED:
            break
        state = replace(trajectory.state, forces=trajectory.state.forces + change)
        trajectory = motion.trajectory(state)
    return trajectory


def first_values(model: Model, log: LogState, values: Values) -> NDArray[np.float64]:
    """Return the values (w,) at the start of the constants that walk."""
    last = [values[u.key(log.name)] for u in model.walking]
    return np.asarray(np.concatenate([np.empty(0), *last]) - np.sum(log.walks, axis=0))


def jumped(state: TrajectoryState, change: NDArray[np.float64]) -> TrajectoryState:
    """Return a state after a change (12,) of attitude, centre of mass, L and v."""
    return replace(
        state,
        attitude=Rotation.from_rotvec(change[:3]) * state.attitude,
        p_Wcm=state.p_Wcm + change[3:6],
        L=state.L + change[6:9],
        v_Wcm=state.v_Wcm + change[9:12],
    )
