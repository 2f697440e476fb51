"""Links: what changes from the end of a block to the start of the next one, and by how much."""

from dataclasses import dataclass

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.unknowns import Model

CLOSED = 1e-8
"""σ of a change at a closed end, as a share of 1 rad, 1 m, 1 m/s and a fast tumble's momentum."""

JUDGED = 1e-5
"""The same for the χ² by which a step is judged; see `link_cost`."""

FARTHEST = 0.5, 1.0, 1.0
"""σ of a change at an open end: of attitude [rad], centre of mass [m] and its velocity [m/s]."""


@dataclass(frozen=True, eq=False)
class Link:
    """What changes from the end of a block to the start of the next one.

    Attributes:
        gap: time between them [s]. Nothing is known of the joints in a gap, so that attitude,
            centre of mass, L and v begin anew behind it.
        walk: (w,) change of the constants that walk.
        pull: (12,) derivative of half χ² by the change of attitude, centre of mass, L and v, which
            is zero, if the end of the block is closed.
        is_open: whether these may change by any amount.
        span: σ of their change at an open end, as a share of `farthest`.
        push: σ (12,) of their change at a closed end by what acts unmodelled [rad, m, N·m·s, m/s];
            zero if nothing does.

    """

    gap: float
    walk: Array
    pull: Array
    is_open: bool = False
    span: float = 1.0
    push: Array | float = 0.0

    @classmethod
    def closed(cls, model: Model, gap: float = 0.0) -> "Link":
        """Return the link behind which a log goes on, before the first fit."""
        return cls(gap, np.zeros(len(model.walking_columns)), np.zeros(12))


def link_sigma(model: Model, link: Link) -> Array:
    """Return σ (12,) of a change of attitude, centre of mass, L and v at a link."""
    return _sigma(model, link, CLOSED)


def link_cost(model: Model, link: Link, change: Array) -> float:
    """Return χ² of a change (12,) at a link.

    A closed end would have a χ² that hides that of all samples where a step leaves a change of
    second order: here it costs 2 λᵀu + |u/σ|² with the pull λ of the end and a larger σ (augmented
    Lagrangian; Nocedal and Wright 2006, ch. 17.3).
    """
    judged = _sigma(model, link, JUDGED)
    if link.is_open:
        return float(np.sum((change / judged) ** 2))
    # |(u − a)/σ|² + λᵀ(2u − a), with a = λ σ² of a closed end, where the pull holds it
    aim = link.pull * link_sigma(model, link) ** 2
    square = float(np.sum(((change - aim) / judged) ** 2))
    return square + float(link.pull @ (2 * change - aim))


def farthest(model: Model) -> Array:
    """Return σ (12,) of a change of attitude, centre of mass, L and v at an open end."""
    return _sizes(model, *FARTHEST)


def _sigma(model: Model, link: Link, closed: float) -> Array:
    """Return σ (12,) of a change at a link; a closed one has a share of its sizes, and its push."""
    if link.is_open or link.gap:
        return link.span * farthest(model)
    return np.hypot(_sizes(model, closed, closed, closed), link.push)


def _sizes(model: Model, turn: float, place: float, speed: float) -> Array:
    return np.repeat([turn, place, speed * model.L_sigma, speed], 3)
