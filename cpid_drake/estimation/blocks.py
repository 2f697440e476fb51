"""The likelihood solved block by block: a square-root information filter over blocks of time.

What is known at the end of a block about X = [start, momentum, biases, joints, ψ] is a square root
of information, R δX + G p = z with unit noise, where p are the errors of the known bodies in units
of σ, less those that the tree contains. The next block adds its rows and eliminates, by one QR
factorization, all that the block after it does not need. ψ is last in X, so the last corner of R is
the information about ψ. The rows that are left over contain p alone. Source: Bierman 1977,
Factorization Methods for Discrete Sequential Estimation, ch. V, VII and VIII.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.plane import HELD
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.sensitivity import with_errors
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.block_equations import CURVED, BlockEquations
from cpid_drake.estimation.block_state import BlockFit, BlockState, solution
from cpid_drake.estimation.jumps import CHANGED, SIZE, Jump
from cpid_drake.estimation.likelihood.constants import NOT_MOVED, Constants
from cpid_drake.estimation.likelihood.joint_block import JointBlock
from cpid_drake.estimation.likelihood.joint_motion import KICK, ORDER
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.estimation.likelihood.motion import TrajectoryState
from cpid_drake.estimation.likelihood.thrust import impulses
from cpid_drake.estimation.square_root import triangle
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.sensors import Gyro
from cpid_drake.sensing.suite import SensorSuite

MOST_ITERATIONS = 6
"""Largest number of linearizations of one block."""

_MOST_TURN = 1e3
"""Change of the attitude in one step from which the solution is meaningless [rad]."""


@dataclass(frozen=True, eq=False)
class BlockSolver:
    """Solves blocks for one spacecraft; it contains no state.

    Attributes:
        tree: the known spacecraft.
        suite: its sensors.
        known_bodies: uncertainty of the spacecraft's bodies; None if they are exact.
        misfit: expected χ² per degree of freedom: above 1 if the noise is larger than given.
        errors: (c,) errors of these bodies that the tree contains, in units of σ; all is linear in
            what remains of them.
        finer: by how many sizes the joints' splines are finer than the joints' sensors ask for.
        is_about_constants: whether the constant errors keep their nominal values from block to
            block, as ψ does, because they were estimated before.
        places: places of all quantities in δX, by name.
        constants: the constant errors of the suite.
        held_count: number of the last quantities in δX whose nominal values remain if that of ψ
            does.

    """

    tree: KinematicTree
    suite: SensorSuite
    known_bodies: BodyUncertainty | None = None
    errors: NDArray[np.float64] | None = None
    misfit: float = 1.0
    finer: int = 0
    is_about_constants: bool = False
    places: dict[str, slice] = field(init=False)
    constants: Constants = field(init=False)
    held_count: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "constants", Constants.of(self.suite, self.joint_count))
        if self.known_bodies is None:
            object.__setattr__(self, "tree", self.tree.lumped)
        sizes = {"attitude": 3, "p_Wcm": 3, "L": 3, "v_Wcm": 3, "bias": 3 * len(self.gyros)}
        sizes |= {"joints": ORDER * self.joint_count}
        errors = self.constants.errors
        sizes |= {error.name: error.size for error in errors.values()} | {"psi": 10}
        ends = np.cumsum(list(sizes.values())).tolist()
        places = {name: slice(end - n, end) for (name, n), end in zip(sizes.items(), ends)}
        object.__setattr__(self, "places", places)
        held = self.constants.steady_count if self.is_about_constants else 0
        object.__setattr__(self, "held_count", held + 10)

    @property
    def gyros(self) -> list[Gyro]:
        """Errors of the gyros."""
        return [errors for errors in self.suite.present().values() if isinstance(errors, Gyro)]

    @property
    def held(self) -> list[str]:
        """Names of the quantities whose nominal values do not move within a block."""
        errors = self.constants.errors.values()
        return ["joints", *(error.name for error in errors if error.kind in NOT_MOVED)]

    @property
    def joint_count(self) -> int:
        """Number of joints."""
        return sum(body.joint >= 0 for body in self.tree.bodies)

    @property
    def consider_count(self) -> int:
        """Number of uncertain quantities of the known bodies and of their geometry."""
        if self.known_bodies is None:
            return 0
        return self.known_bodies.count(self.tree.wheels, self.joint_count)

    def model(
        self,
        joints: JointBlock,
        measurements: Measurements,
        nominal: NDArray[np.float64] | None = None,
    ) -> BlockModel:
        """Return the likelihood of a block; for `nominal` see `BlockModel`."""
        bodies, constants = self.known_bodies, self.constants
        return BlockModel(
            self.tree,
            joints,
            measurements,
            self.suite,
            bodies,
            constants=constants,
            nominal=nominal,
        )

    def solve(
        self,
        state: BlockState,
        model: BlockModel,
        *,
        plausible: NDArray[np.float64] | None = None,
        weights: NDArray[np.float64] | None = None,
        tolerance: float = CURVED,
    ) -> BlockFit:
        """Return the solution of a block by the Gauss-Newton method.

        Args:
            state: at the start of the block.
            model: the likelihood of the block.
            plausible: (10,) plausible sizes of ψ, whose nominal value moves along well-known
                combinations; None to hold it. All other nominal values become the best for it.
            weights: (samples,) 0 for samples to leave out, in the order of the sensors.
            tolerance: change of χ² by curvature above which the block is linearized again.

        Raises:
            InputError: the readings cannot be predicted at the nominal values.

        """
        equations = BlockEquations(self, self.kicked(state, model), model, weights)
        for _ in range(MOST_ITERATIONS):
            equations.solve(plausible)
            if not equations.relinearized(tolerance):
                break
        else:  # the last linearization needs its own solution
            equations.solve(plausible)
        fit = equations.fit(plausible)
        return replace(fit, state=self.walked(fit.state, fit.state.time - state.time))

    def walked(self, state: BlockState, elapsed: float) -> BlockState:
        """Return a state after the random walks of the constants during a time [s]."""
        errors = [error for error in self.constants.errors.values() if error.walk]
        if not errors or not elapsed > 0:
            return state
        grown = {e.name: e.walk * np.sqrt(elapsed) / e.sigma for e in errors}
        return self.loosened(state, grown)

    def coasted(
        self, state: BlockState, elapsed: float, thrust: Samples | None = None
    ) -> BlockState:
        """Return a state after a time in which the external forces change the momentum.

        The attitude is not known, so the momentum from gravity gradient and thrust is not known
        either.

        Args:
            state: before.
            elapsed: the time [s].
            thrust: the log of thrust; None without one.

        """
        root, value = state.root.copy(), self.constants.value
        nominal = state.nominal
        now = {"L": nominal.L, "v_Wcm": nominal.v_Wcm}
        for name, changed in (("torque", "L"), ("acceleration", "v_Wcm")):
            force = value(nominal.constants, name)
            if force is not None:
                share = elapsed * self.constants.errors[name].sigma
                root[:, self.places[name]] -= share * root[:, self.places[changed]]
                now[changed] = now[changed] + elapsed * force
        orbit = self.suite.orbit
        if orbit is not None:
            drift = orbit.transition(state.time, np.array(state.time + elapsed))[3:]
            now["v_Wcm"] = now["v_Wcm"] + drift @ [*nominal.p_Wcm, *nominal.v_Wcm] - nominal.v_Wcm
        nominal = replace(nominal, L=now["L"], v_Wcm=now["v_Wcm"])
        state = self.walked(replace(state, root=root, nominal=nominal), elapsed)
        turn, push = (0.0, 0.0) if thrust is None else impulses(thrust, state.time, elapsed)
        if orbit is None and not (turn or push):
            return state
        still = np.zeros((1, self.joint_count))
        dynamics = relative_dynamics(self.tree, still, still)
        arm = float(np.linalg.norm(dynamics.com(nominal.psi)[0]))
        added = {"L": turn + arm * push, "v_Wcm": push / dynamics.mass}
        if orbit is not None:
            trace = float(np.trace(dynamics.inertia(nominal.psi)[0]))
            added["L"] += 1.5 * orbit.n**2 * trace * elapsed
        return self.loosened(state, added)

    def kicked(self, state: BlockState, model: BlockModel) -> BlockState:
        """Return a state whose joint accelerations are not known if thrusters switch at the start.

        Args:
            state: at the start of a block.
            model: the likelihood of the block.

        """
        if not model.motion.joints.is_kicked:
            return state
        place = self.places["joints"]
        picked = np.arange(place.start + ORDER - 1, place.stop, ORDER)
        return self._opened(state, picked, np.full(len(picked), 1 / KICK))

    def loosened(self, state: BlockState, sigmas: dict[str, float]) -> BlockState:
        """Return a state in which some quantities have changed by an unknown amount.

        Assumed changes are given up.

        Args:
            state: before the change.
            sigmas: σ of the change of every entry of a quantity, by its name in `places`.

        """
        sigmas = {name: sigma for name, sigma in sigmas.items() if sigma > 0}
        picked = np.concatenate(
            [np.arange(self.places[name].start, self.places[name].stop) for name in sigmas]
        )
        scale = np.concatenate(
            [np.full(self.places[n].stop - self.places[n].start, 1 / s) for n, s in sigmas.items()]
        )
        return self._opened(state, picked, scale)

    def _opened(
        self, state: BlockState, picked: NDArray[np.intp], scale: NDArray[np.float64]
    ) -> BlockState:
        """Return a state in which some entries have changed; `scale` (m,) is 1/σ of each."""
        n, m = len(state.root), len(picked)
        A = np.zeros((m + n, m + n + state.by_bodies.shape[1] + 1))
        A[:m, :m] = np.diag(scale)
        A[m:, :m], A[m:, m : m + n] = -state.root[:, picked], state.root
        A[m:, m + n : -1], A[m:, -1] = state.by_bodies, state.rest
        R = triangle(A)[m : m + n, m:]
        return replace(state, root=R[:, :n], by_bodies=R[:, n:-1], rest=R[:, -1], jumps=())

    def with_assumed_jump(self, state: BlockState) -> BlockState:
        """Return a state in which a change at the present is assumed, to be tested later."""
        jump = Jump.at(state.time, state.root, self.places, self.consider_count)
        return replace(state, jumps=(*state.jumps, jump))

    def with_jump(self, state: BlockState, jump: Jump, sigmas: dict[str, float]) -> BlockState:
        """Return what is known if an assumed change has happened.

        Args:
            state: with the assumed change.
            jump: one of `state.jumps`.
            sigmas: σ of the change of every entry of a quantity, by its name.

        """
        n, c, k = len(state.root), state.by_bodies.shape[1], SIZE
        scale = np.repeat([1 / sigmas[name] for name in CHANGED], 3)
        A = np.zeros((k + n + len(jump.found), k + n + c + 1))
        A[:k, :k] = np.diag(scale)
        A[k : k + n] = np.column_stack([jump.columns, state.root, state.by_bodies, state.rest])
        A[k + n :, :k], A[k + n :, k + n : -1] = jump.found[:, c:-1], jump.found[:, :c]
        A[k + n :, -1] = jump.found[:, -1]
        R = triangle(A)[k : k + n, k:]
        bodies = np.eye(c, c + 1)  # what was learned since then assumed that nothing changed
        return replace(
            state, root=R[:, :n], by_bodies=R[:, n:-1], rest=R[:, -1], bodies=bodies, jumps=()
        )

    def settled(
        self, state: BlockState, plausible: NDArray[np.float64] | None = None
    ) -> BlockState:
        """Return a state with the nominal values, except the joints', moved to the solution.

        Args:
            state: before.
            plausible: see `solve`.

        Raises:
            numpy.linalg.LinAlgError: the samples contradict each other so much that the attitude
                would turn by more than `_MOST_TURN`.

        """
        now = state.nominal
        change = solution(state.root, state.rest, plausible, held=self.held_count)
        if not np.abs(change[self.places["attitude"]]).max() < _MOST_TURN:
            raise np.linalg.LinAlgError("nothing explains the samples")
        change[self.places["joints"]] = 0.0
        if self.tree.normal_B is not None:
            for name in HELD.keys() & self.places.keys():
                change[self.places[name].start + np.array(HELD[name])] = 0.0
        part = {name: change[place] for name, place in self.places.items()}
        constants = now.constants
        for name in self.constants.errors:
            constants = self.constants.moved(constants, name, part[name])
        nominal = TrajectoryState(
            psi=now.psi + part["psi"],
            attitude=Rotation.from_rotvec(part["attitude"]) * now.attitude,
            p_Wcm=now.p_Wcm + part["p_Wcm"],
            v_Wcm=now.v_Wcm + part["v_Wcm"],
            L=now.L + part["L"],
            bias=now.bias + part["bias"].reshape(-1, 3),
            constants=constants,
        )
        return replace(state, nominal=nominal, rest=state.rest - state.root @ change)


def with_bodies(nominal: BlockSolver, errors: NDArray[np.float64] | None) -> BlockSolver:
    """Return the solver of the nominal spacecraft with errors (c,) of its bodies, in units of σ."""
    bodies = nominal.known_bodies
    if errors is None or bodies is None:
        return nominal
    return replace(nominal, tree=with_errors(nominal.tree, bodies, errors), errors=errors)
