"""The blocks before a log's first one: they are behind a window, and marginalized."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.model import jump_between
from cpid_drake.estimation.likelihood.motion_model import TrajectoryState


@dataclass(frozen=True, eq=False)
class Past:
    """A Gaussian of what is at the start of a log's first block, and of all unknowns.

    Its rows are linear about the values at which each block was marginalized. So are the
    derivatives of all later blocks by target and hardware: what no motion identifies, such as where
    C is in the target, would else seem to be known, since derivatives at other values contradict
    each other. Source: Huang, Mourikis and Roumeliotis 2010 (first-estimates Jacobians).

    A log with a past starts from it (`sweep.known_at_start`), has its derivatives at `first`
    (`roll.derivatives`), and has no prior of its start; `following` fits one block behind it alone.

    Attributes:
        gaussian: of attitude, p, L, v, joints and slow noise, then of the table of unknowns, and
            of changes of momentum that are still in question.
        start: the base's state about which it is.
        joints: (ORDER, J) the joints about which it is.
        table: (n,) the values of the table about which it is.
        first: values of target and hardware at which derivatives are taken.
        slow: places of sensors in `edge`.
        edge: (s,) slow noise about which it is.

    """

    gaussian: Gaussian
    start: TrajectoryState
    joints: Array
    table: Array
    first: Mapping[str, Array]
    slow: Mapping[str, slice] = field(default_factory=dict)
    edge: Array = field(default_factory=lambda: np.zeros(0))

    def about(
        self,
        start: TrajectoryState,
        joints: Array,
        table: Array,
        slow: Mapping[str, slice],
        sigma: Array,
        edge: Array,
    ) -> Gaussian:
        """Return the Gaussian about other values; slow noise that is new has its prior."""
        jump, turned = jump_between(self.start, start), (joints - self.joints).T.ravel()
        mean = [edge[slow[name]] if name in slow else self.edge[p] for name, p in self.slow.items()]
        moved = np.concatenate([np.empty(0), *mean]) - self.edge
        step = np.concatenate([jump, turned, moved, table - self.table])
        about = self.gaussian.minus(np.pad(step, (0, self.gaussian.size - len(step))))
        if slow == self.slow:
            return about
        first, n = 12 + joints.size, about.size
        end = first + len(self.edge)
        before = {name: np.arange(p.start, p.stop) + first for name, p in self.slow.items()}
        nothing = np.full(len(edge), n)  # what is new
        now = [before.get(name, nothing[place]) for name, place in slow.items()]
        gone = [columns for name, columns in before.items() if name not in slow]
        count = sum(map(len, gone))
        pick = np.concatenate([*gone, np.arange(first), *now, np.arange(end, n)]).astype(int)
        rows = np.column_stack([about.R, np.zeros(n)])[:, pick]
        is_new = pick == n
        prior = np.zeros((int(np.sum(is_new)), len(pick) + 1))
        prior[np.arange(len(prior)), np.flatnonzero(is_new)] = 1.0
        prior[:, -1] = -edge[is_new[count + first :][: len(edge)]]
        new = np.concatenate([np.empty(0), *(sigma[p] for n, p in slow.items() if n not in before)])
        boundary, *others = about.sizes
        sizes = {"gone": count, boundary: first + len(edge)}
        sizes |= {name: about.sizes[name] for name in others}
        both = np.vstack([np.column_stack([rows, about.z]), prior / new[:, None]])
        joint = Gaussian.of_rows(sizes, both, about.rho2)
        volume = about.volume + float(np.sum(np.log(new)))
        volume += float(np.sum(np.log(np.abs(np.diag(joint.R)[:count]))))
        return replace(joint.marginal([boundary, *others]), volume=volume)
