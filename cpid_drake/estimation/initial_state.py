"""What is known before the first block: the prior, about nominal values from the first samples."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.plane import HELD, NORMAL_W
from cpid_drake.estimation.block import Block, first_sample
from cpid_drake.estimation.block_state import BlockState
from cpid_drake.estimation.blocks import BlockSolver
from cpid_drake.estimation.faults import block_model, with_first_attitude
from cpid_drake.estimation.likelihood.constants import OF_GRASP
from cpid_drake.estimation.likelihood.motion import TrajectoryState
from cpid_drake.estimation.likelihood.priors import Prior
from cpid_drake.sensing.sensors import ANGULAR_VELOCITY, POSITION


def initial_state(
    solver: BlockSolver,
    prior: Prior,
    psi: NDArray[np.float64],
    block: Block,
    constants: NDArray[np.float64] | None = None,
) -> BlockState:
    """Return what is known before the first block, about nominal values from its first samples.

    Args:
        solver: the solver of the blocks.
        prior: what is known before the first sample.
        psi: (10,) nominal value of the target's unknowns.
        block: the first block.
        constants: (k,) nominal values of the constant errors in units of their σ, those of the
            grasp excepted, which are zero; default: zero.

    Raises:
        InputError: the block has no attitude sample, or too few samples of the joints' positions.

    """
    places = solver.places
    n = places["psi"].stop
    sigma, rest = np.empty(n), np.zeros(n)
    sigma[places["attitude"]], sigma[places["p_Wcm"]] = np.pi, 1e3
    sigma[places["L"]], sigma[places["v_Wcm"]] = prior.L_sigma, prior.v_sigma
    sigma[places["bias"]] = np.repeat([max(g.bias_sigma, 1e-9) for g in solver.gyros], 3)
    sigma[places["joints"]], sigma[places["psi"]] = 1e6, prior.psi_sigma
    start = np.zeros(solver.constants.size)
    for name in solver.constants.errors:
        sigma[places[name]] = 1.0
        if constants is not None and name not in OF_GRASP:
            place = solver.constants.place(name)
            start[place] = constants[place]
            if name in HELD and solver.tree.normal_B is not None:
                start[place.start + np.array(HELD[name])] = 0.0
            rest[places[name]] = -start[place]
    rest[places["psi"]] = (prior.psi - psi) / prior.psi_sigma
    position = first_sample(block.samples, POSITION)
    nominal = TrajectoryState(
        psi=psi,
        attitude=Rotation.identity(),
        p_Wcm=np.zeros(3) if position is None else position,
        v_Wcm=prior.momentum.v_WScm_W,
        L=_conserved(solver, prior.momentum.L_WScm_W),
        bias=np.zeros((len(solver.gyros), 3)),
        constants=start,
    )
    by_bodies = np.zeros((n, solver.consider_count))
    bodies = np.eye(by_bodies.shape[1], by_bodies.shape[1] + 1)
    if solver.errors is not None:
        bodies[:, -1] = -solver.errors
    root = np.diag(1 / sigma)
    state = BlockState(
        block.start, nominal, None, root, by_bodies, rest, bodies, errors=solver.errors
    )
    state = with_first_attitude(state, block, solver.tree.normal_B)
    if prior.momentum.is_unknown:
        state = _with_first_momentum(solver, state, block)
    return state


def _with_first_momentum(solver: BlockSolver, state: BlockState, block: Block) -> BlockState:
    """Return a state whose nominal momentum is that of the first angular velocity."""
    dynamics = block_model(solver, state, block).motion.grid.dynamics
    w = first_sample(block.samples, ANGULAR_VELOCITY)
    if w is None:
        w = np.zeros(3)
        for sensor in block.samples.samples.values():
            if sensor.value.shape[1:] == (4,) and len(sensor) > 1:
                R = Rotation.from_quat(sensor.value, scalar_first=True)
                elapsed = sensor.time[-1] - sensor.time[0]
                w = (R[0].inv() * R[-1]).as_rotvec() / elapsed
    psi = state.nominal.psi
    L = dynamics.inertia(psi)[0] @ w + dynamics.momentum_at_rest(psi)[0]
    # The momentum is known to be L0 ± σ; about another nominal value the right-hand side differs.
    L = _conserved(solver, state.nominal.attitude.apply(L))
    place = solver.places["L"]
    rest = state.rest.copy()
    rest[place] = state.root[place, place] @ (state.nominal.L - L)
    return replace(state, nominal=replace(state.nominal, L=L), rest=rest)


def _conserved(solver: BlockSolver, L: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the conserved part of an angular momentum in W: on a table only that along z."""
    return L if solver.tree.normal_B is None else L * NORMAL_W
