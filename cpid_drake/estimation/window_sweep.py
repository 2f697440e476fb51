"""All blocks of a window at one target: the best values of everything else, and χ²."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.estimation.block import Block
from cpid_drake.estimation.block_equations import CURVED
from cpid_drake.estimation.block_state import BlockFit, BlockState
from cpid_drake.estimation.blocks import BlockSolver
from cpid_drake.estimation.faults import Explained, block_model, bridged, explain
from cpid_drake.estimation.initial_state import initial_state
from cpid_drake.estimation.likelihood.joint_block import JointBlock
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.estimation.likelihood.priors import Prior


@dataclass(frozen=True, eq=False)
class Sweep:
    """All blocks of a window at one ψ.

    Attributes:
        state: what is known at the end, at this nominal ψ.
        fits: of the blocks.
        about: (k,) values of the constant errors about which it is linear.
        bridged: start and end of the pieces that were bridged [s].
        left_out: number of samples left out, by sensor.

    """

    state: BlockState
    fits: tuple[BlockFit, ...]
    about: NDArray[np.float64]
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


class WorkLimitError(Exception):
    """The fits of an update would take more than the allowed work."""


@dataclass(eq=False)
class Work:
    """The work of the fits of one update.

    Attributes:
        most: largest number of block solutions; None for no limit.
        done: block solutions so far.

    """

    most: int | None = None
    done: int = 0

    def add(self) -> None:
        """Count one more block solution.

        Raises:
            WorkLimitError: there would be more than allowed.

        """
        if self.most is not None and self.done >= self.most:
            raise WorkLimitError
        self.done += 1


class WindowModels:
    """The likelihoods of successive blocks, prepared once for many sweeps.

    All blocks of a sweep are linearized about the same constant errors: at first about the given
    ones, then about the best ones of the sweep before. The joints' zeros remain the given ones.
    """

    def __init__(
        self,
        solver: BlockSolver,
        prior: Prior,
        blocks: Sequence[Block],
        constants: NDArray[np.float64] | None = None,
        work: Work | None = None,
    ) -> None:
        self.solver = solver = replace(solver, is_about_constants=True)
        self.prior, self.blocks, self.work = prior, blocks, work or Work()
        self.constants = np.zeros(solver.constants.size) if constants is None else constants
        self._models: list[BlockModel] = []
        state = initial_state(solver, prior, prior.psi, blocks[0], self.constants)
        track = None
        for block in blocks:
            model = block_model(solver, replace(state, track=track), block)
            self._models.append(model)
            joints = model.motion.joints
            assert isinstance(joints, JointBlock)
            track = joints.track

    def sweep(
        self,
        psi: NDArray[np.float64],
        changed: int = -1,
        *,
        near: Sweep | None = None,
        tolerance: float = CURVED,
    ) -> Sweep:
        """Return the sweep at ψ after the sweep `near`; the block number `changed` is bridged.

        For `tolerance` see `BlockSolver.solve`.

        Raises:
            WorkLimitError: see `Work`.

        """
        constants = self.constants
        if near is not None:
            best = near.state.best_constants(psi)
            constants = self.solver.constants.with_zeros(best, self.constants)
        state = initial_state(self.solver, self.prior, psi, self.blocks[0], constants)
        fits: list[BlockFit] = []
        pieces: tuple[tuple[float, float], ...] = ()
        for k, model in enumerate(self._models):
            self.work.add()
            if k == changed:
                state = bridged(self.solver, self.prior, state, model, None)
                pieces = ((self.blocks[k].start, self.blocks[k].end),)
                continue
            fits.append(self.solver.solve(state, model, tolerance=tolerance))
            state = fits[-1].state
        return Sweep(state, tuple(fits), constants, pieces)


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
    about = np.zeros(solver.constants.size) if constants is None else constants
    whole = Explained(initial_state(solver, prior, psi, blocks[0], about))
    for block in blocks:
        whole = whole.then(explain(solver, prior, whole.state, block))
    return Sweep(whole.state, whole.fits, about, whole.bridged, whole.left_out)
