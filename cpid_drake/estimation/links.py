"""Changes of attitude, centre of mass and momentum between blocks, as unknowns: links.

A link acts with a probability w, and has the size a of its σ that its evidence prefers; see
`evidence`. So its prior has the variance w a² σ²: one that the samples exclude is zero, one that
acts is free, and one that they cannot tell from none widens the intervals.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cpid_drake.estimation.evidence import Comparison, compare
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.sweep import EXACT
from cpid_drake.estimation.unknowns import PSI, Model

ODDS = 1 / 40
"""A change is expected at the start of one of so many blocks."""


@dataclass(frozen=True)
class Link:
    """A change of attitude, centre of mass and momentum at the start of a block.

    Attributes:
        time: the start of the block [s].
        probability: that something changed.
        size: of the change, as a share of its σ.

    """

    time: float
    probability: float = 1.0
    size: float = 1.0

    @property
    def name(self) -> str:
        """Name of the change as an unknown."""
        return f"link {self.time!r}"


def judged(model: Model, gaussian: Gaussian, links: Sequence[Link]) -> tuple[Link, ...]:
    """Return the links with the probabilities and sizes that the evidence shows."""
    if not links:
        return ()
    found = compared(model, gaussian, [link.name for link in links])
    return tuple(
        replace(each, probability=found.probability[each.name], size=found.sizes.get(each.name, 0))
        for each in links
    )


def compared(model: Model, gaussian: Gaussian, names: Sequence[str]) -> Comparison:
    """Return the comparison of changes that are unknowns of these names."""
    sigma, odds = dict.fromkeys(names, model.farthest), dict.fromkeys(names, ODDS)
    return compare(gaussian, sigma, [PSI], odds)


def with_links(model: Model, gaussian: Gaussian, links: Sequence[Link]) -> Gaussian:
    """Return what is known if the links are as large as their evidence shows."""
    if not links:
        return gaussian
    shares = [max(np.sqrt(link.probability) * link.size, EXACT) for link in links]
    sigma = np.concatenate([share * model.farthest for share in shares])
    rows = np.column_stack([np.diag(1 / sigma), np.zeros(len(sigma))])
    return gaussian.add(Gaussian.of_rows({link.name: 12 for link in links}, rows))


def closed(model: Model, gaussian: Gaussian, links: Sequence[Link]) -> Gaussian:
    """Return what is known of the others if some links are as large as their evidence shows."""
    names = [link.name for link in links]
    others = [name for name in gaussian.places if name not in names]
    return with_links(model, gaussian, links).marginal(others)
