"""Prediction of a log: the samples of all blocks at given values of all unknowns."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.estimation.block_rows import BlockRows
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.joint_model import ORDER
from cpid_drake.estimation.likelihood.kinematic_changes import relate, with_changes
from cpid_drake.estimation.likelihood.model import BlockModel, jump_between
from cpid_drake.estimation.likelihood.motion_model import Trajectory, TrajectoryState
from cpid_drake.estimation.likelihood.white_reading import WhiteReading
from cpid_drake.estimation.links import link_cost
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.target import psi_about
from cpid_drake.estimation.unknowns import BODIES, PSI, Model
from cpid_drake.estimation.whitening import white_residuals

Values = dict[str, Array]
"""Present values of all unknowns of all logs, by name."""


@dataclass(frozen=True, eq=False)
class BlockPrediction:
    """What the model of a block predicts, without what is of first order.

    That are compliances and accelerations in B; see `error_effects.OF_FIRST_ORDER`.

    Attributes:
        trajectory: of the base.
        residuals: (M, d) (y − h(x)) / σ with the declared σ, by sensor.
        end: of the block.

    """

    trajectory: Trajectory
    residuals: dict[str, Array]
    end: TrajectoryState

    @classmethod
    def of(cls, model: BlockModel, trajectory: Trajectory) -> "BlockPrediction":
        """Return the prediction for a trajectory."""
        residuals = {name: each.residuals(trajectory) for name, each in model.sensors.items()}
        return cls(trajectory, residuals, model.motion.end(trajectory))


@dataclass(frozen=True, eq=False)
class Rolled:
    """A log, predicted at given values.

    Attributes:
        models: of each block.
        predictions: what they predict.
        residuals: of each block: those of `predictions`, less what is of first order.
        ends: of each block.
        jumps: of each block but the last: (12,) change of attitude, centre of mass, L and v from
            its end to the start of the next; zero if a gap is between them.
        joint_cost: sum of squares of the rows of joints and of what walks.
        start_cost: sum of squares of what is known at its start.
        jacobians: derivatives of samples and ends of blocks, as far as they have been linearized.
        rows: their rows, as they were last needed.
        first_order_jacobians: the derivatives (m, n) and (12, n) by errors of first order with
            which these are in the prediction, as far as they are known.
        psi_jacobian: (10, 10) derivative of ψ about the spacecraft's present mass by the target's
            coordinates.

    """

    models: list[BlockModel]
    predictions: list[BlockPrediction]
    residuals: list[dict[str, Array]]
    ends: list[TrajectoryState]
    jumps: list[Array]
    joint_cost: float
    start_cost: float
    psi_jacobian: Array
    jacobians: dict[BlockModel, tuple[Array, Array]] = field(default_factory=dict)
    rows: dict[BlockModel, BlockRows] = field(default_factory=dict)
    first_order_jacobians: dict[BlockModel, tuple[Array, Array]] = field(default_factory=dict)

    @property
    def trajectories(self) -> list[Trajectory]:
        """Of the base in each block."""
        return [each.trajectory for each in self.predictions]

    def part(self, first: int, end: int) -> "Rolled":
        """Return the prediction of the blocks from `first` up to `end`."""
        return replace(
            self,
            models=self.models[first:end],
            predictions=self.predictions[first:end],
            residuals=self.residuals[first:end],
            ends=self.ends[first:end],
            jumps=self.jumps[first:end],
        )

    def take_derivatives(self, other: "Rolled") -> None:
        """Take the derivatives of the blocks of a prediction nearby, as far as they are known."""
        for own, before in zip(self.models, other.models, strict=True):
            if own not in self.jacobians and before in other.jacobians:
                self.jacobians[own] = other.jacobians[before]

    def renewed(self, model: Model, log: LogState, values: Values, share: float) -> "Rolled":
        """Return the prediction with what is of first order by a share of its own derivatives.

        The rest is by those with which it is now.
        """
        if not self.first_order_jacobians or all(part in self.jacobians for part in self.models):
            return self
        renewed = replace(self, first_order_jacobians={})
        linearize(model.of_log(log.name), log, renewed, values)
        for part, before in self.first_order_jacobians.items():
            for whole, old in zip(renewed.jacobians[part], before, strict=True):
                own = whole[:, part.of_first_order]
                whole[:, part.of_first_order] = old + share * (own - old)
        return renewed.with_first_order(log, renewed)

    def with_first_order(self, log: LogState, near: "Rolled") -> "Rolled":
        """Return it with what is of first order, by derivatives of a prediction nearby."""
        residuals, ends = list[dict[str, Array]](), list[TrajectoryState]()
        first_order_jacobians = dict[BlockModel, tuple[Array, Array]]()
        entries = self.models[0].motion.constants.first_order
        for k, predicted in enumerate(self.predictions):
            rest, end = predicted.residuals, predicted.end
            block_model, other = self.models[k], near.models[k]
            if other in near.jacobians:
                columns = block_model.of_first_order
                J, end_jacobian = (each[:, columns] for each in near.jacobians[other])
                first_order_jacobians[block_model] = J, end_jacobian
                x = predicted.trajectory.state.constants[entries]
                ends_of = np.cumsum([0, *map(np.size, rest.values())])
                moved = np.split(J @ x, ends_of)[1 : len(rest) + 1]
                parts = zip(rest.items(), moved, strict=True)
                rest = {name: own - by.reshape(own.shape) for (name, own), by in parts}
                end = jumped(end, end_jacobian @ x)
            residuals.append(rest)
            ends.append(end)
        return replace(
            self,
            residuals=residuals,
            ends=ends,
            jumps=_jumps(log, ends),
            first_order_jacobians=first_order_jacobians,
        )

    @property
    def count(self) -> int:
        """Number of all residuals."""
        return sum(rest.size for block in self.residuals for rest in block.values())

    def cost(self, model: Model, log: LogState, step: Values | None = None) -> float:
        """Return the sum of squares of all rows of a log.

        Args:
            model: the unknowns.
            log: the log.
            step: of all unknowns since white torques were linear in the inertia.

        """
        links = sum(link_cost(model, log.links[k], u) for k, u in enumerate(self.jumps))
        slow = 0.0 if log.past else float(np.sum((log.states[0].slow / log.noise.slow_sigma) ** 2))
        return self.start_cost + slow + links + self.cost_inside(log, step)

    def cost_inside(self, log: LogState, step: Values | None = None) -> float:
        """Return the sum of squares of the rows of a log's blocks alone; see `cost`."""
        total = self.joint_cost
        for k, block in enumerate(self.residuals):
            changed = dict(block)
            for name, rest in block.items():
                sensor = self.models[k].sensors[name]
                if step and isinstance(sensor, WhiteReading):
                    for effect, by in sensor.by_unknowns(self.predictions[k].trajectory).items():
                        by = by @ self.psi_jacobian if effect == PSI else by
                        rest = rest - by @ step[effect] if effect in step else rest
                    changed[name] = rest
            white = white_residuals(log, k, changed)
            total += sum(float(np.sum(each**2)) for each in white.values())
        return total

    def all_residuals(self) -> dict[str, Array]:
        """Return the residuals of each sensor, block after block."""
        names = sorted({name for block in self.residuals for name in block})
        return {n: np.concatenate([b[n] for b in self.residuals if n in b]) for n in names}


def constants_of(model: Model, log: LogState, values: Values) -> Array:
    """Return the constants (k,) of a log; of those that walk, the last value."""
    parts = [values[u.key(log.name)] for u in model.table if u.name in model.constants.errors]
    return np.concatenate([np.empty(0), *parts])


def roll(
    model: Model,
    log: LogState,
    values: Values,
    before: Rolled | None = None,
    near: Rolled | None = None,
) -> Rolled:
    """Predict all samples of a log.

    Every block begins at its own start, so that what a step is wrong by in one block does not grow
    in those that follow (multiple shooting; Bock and Plitt 1984).

    Args:
        model: the unknowns.
        log: the log.
        values: of the unknowns.
        before: a prediction of some of the blocks, which is kept where nothing has changed.
        near: one of all blocks, with derivatives: what is of first order is by these; default: by
            those at the values.

    Raises:
        InputError: no rigid body has these values.

    """
    model = model.of_log(log.name)
    models, trajectories, psi_jacobian = motions_of(model, log, values, before)
    kept = dict(zip(before.models, before.predictions, strict=True)) if before else {}
    pairs = zip(models, trajectories, strict=True)
    predictions = [kept.get(part) or BlockPrediction.of(part, moved) for part, moved in pairs]
    cost = 0.0
    for part in models:
        cost += float(np.sum(part.motion.joints.rest**2))
    for k, link in enumerate(log.links):
        # Σ |u|²/(σ² Δt)
        cost += float(np.sum((link.walk / model.walking_sigma) ** 2)) / log.interval(k)
    jacobians, rows, present = {}, {}, set(models)
    if before:
        jacobians = {part: each for part, each in before.jacobians.items() if part in present}
        rows = {part: each for part, each in before.rows.items() if part in present}
    start = _start_cost(model, log, values)
    residuals, ends = [each.residuals for each in predictions], [each.end for each in predictions]
    jumps, derived = _jumps(log, ends), (psi_jacobian, jacobians, rows)
    made = Rolled(models, predictions, residuals, ends, jumps, cost, start, *derived)
    first_order = model.constants.first_order
    if not len(first_order):
        return made
    if near is None and any(each.state.constants[first_order].any() for each in trajectories):
        linearize(model, log, made, values)
    return made.with_first_order(log, near or made)


def _jumps(log: LogState, ends: Sequence[TrajectoryState]) -> list[Array]:
    """Return the changes (12,) from the ends of blocks to the starts of those that follow."""
    return [
        jump_between(end, start) if not link.gap else np.zeros(12)
        for end, start, link in zip(ends[:-1], log.starts[1:], log.links, strict=True)
    ]


def derivatives(
    model: Model, log: LogState, rolled: Rolled, values: Values
) -> Iterator[tuple[Array, Array]]:
    """Yield the derivatives of samples and end of all blocks, without slow noise.

    Behind a past they are those at the first values of target and hardware; see `Past`. Those by
    errors of first order are those of the prediction.
    """
    new = [k for k, part in enumerate(rolled.models) if part not in rolled.jacobians]
    models, trajectories, psi_jacobian = rolled.models, rolled.trajectories, rolled.psi_jacobian
    has_hardware = any(unknown.scope == "hardware" for unknown in model.table)
    if new and log.past is not None and has_hardware:
        values = {**values, **log.past.first}
        models, trajectories, psi_jacobian = motions_of(model, log, values)
    bent = with_changes([trajectories[k] for k in new])
    for part, nearby in zip(rolled.models, models, strict=True):
        if part not in rolled.jacobians:
            J, end = nearby.jacobian(next(bent))
            psi = nearby.columns[PSI]
            J[:, psi], end[:, psi] = J[:, psi] @ psi_jacobian, end[:, psi] @ psi_jacobian
            if part in rolled.first_order_jacobians:
                columns, before = part.of_first_order, rolled.first_order_jacobians[part]
                J[:, columns], end[:, columns] = before
            rolled.jacobians[part] = J, end
        yield rolled.jacobians[part]


def linearize(model: Model, log: LogState, rolled: Rolled, values: Values) -> None:
    """Give a prediction the derivatives of all blocks, before parts of it are swept."""
    for _ in derivatives(model, log, rolled, values):
        pass


def motions_of(
    model: Model, log: LogState, values: Values, before: Rolled | None = None
) -> tuple[list[BlockModel], list[Trajectory], Array]:
    """Return models and trajectories of all blocks, and the derivative `Rolled.psi_jacobian`.

    Args:
        model: the unknowns of the log.
        log: the log.
        values: of the unknowns.
        before: see `roll`.

    Raises:
        InputError: no rigid body has these values.

    """
    tree = model.tree_with(values.get(BODIES))
    psi, psi_jacobian = psi_about(values[PSI], model.mass, tree.mass)
    last, walking = constants_of(model, log, values), model.walking_columns
    # of each block: what is still to come
    walks = [link.walk for link in log.links]
    later = np.cumsum([np.zeros(len(walking)), *reversed(walks)], axis=0)[::-1]
    models, trajectories, firsts = list[BlockModel](), dict[int, Trajectory](), {}
    done = zip(before.models, before.trajectories, strict=True) if before else ()
    by_joints = {part.motion.joints: (part, trajectory) for part, trajectory in done}
    for k, state in enumerate(log.states):
        constants = last.copy()
        constants[walking] -= later[k]
        first = replace(log.starts[k], psi=psi, constants=constants, forces=state.forces)
        if state.joints in by_joints:
            part, trajectory = by_joints[state.joints]
            if part.motion.tree is tree and _is_same(trajectory.state, first):
                models.append(part)
                trajectories[k] = trajectory
                continue
        part = BlockModel(
            tree,
            state.joints,
            state.block.samples,
            model.suite,
            model.known_bodies,
            constants=model.constants,
            nominal=constants,
            errors=values.get(BODIES),
            origin=log.origin,
        )
        models.append(part)
        firsts[k] = first
    relate([models[k].motion for k in firsts], psi)
    trajectories |= {k: models[k].motion.trajectory(first) for k, first in firsts.items()}
    return models, [trajectories[k] for k in range(len(models))], psi_jacobian


def _is_same(state: TrajectoryState, other: TrajectoryState) -> bool:
    """Return whether two states have the same entries, and the very same attitude."""
    pairs = zip(vars(state).values(), vars(other).values(), strict=True)
    return all(a is b or (isinstance(a, np.ndarray) and np.array_equal(a, b)) for a, b in pairs)


def past_of(model: Model, log: LogState, values: Values) -> Gaussian:
    """Return the Gaussian of a log's past, about the present values at the log's start."""
    assert log.past is not None
    joints = log.states[0].joints.coefficients[:ORDER]
    slow = log.noise.slow_places, log.noise.slow_sigma, log.states[0].slow
    return log.past.about(log.starts[0], joints, first_table(model, log, values), *slow)


def first_table(model: Model, log: LogState, values: Values) -> Array:
    """Return the values (n,) of the table; of what walks, those at the start of a log."""
    table = np.concatenate([values[u.key(log.name)] for u in model.table])
    table[model.walking_columns] -= sum([link.walk for link in log.links])
    return table


def _start_cost(model: Model, log: LogState, values: Values) -> float:
    """Return the sum of squares of what is known at a log's start."""
    if log.past is None:
        return float(np.sum(first_values(model, log, values) ** 2))
    past = past_of(model, log, values)
    return past.cost(np.zeros(past.size))


def first_values(model: Model, log: LogState, values: Values) -> Array:
    """Return the values (w,) at the start of the constants that walk."""
    return first_table(model, log, values)[model.walking_columns]


def jumped(state: TrajectoryState, change: Array) -> TrajectoryState:
    """Return a state after a change (12,) of attitude, centre of mass, L and v."""
    return replace(
        state,
        attitude=Rotation.from_rotvec(change[:3]) * state.attitude,
        p_Wcm=state.p_Wcm + change[3:6],
        L=state.L + change[6:9],
        v_Wcm=state.v_Wcm + change[9:12],
    )
