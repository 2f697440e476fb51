"""A description in words of the unknowns that the data do not determine."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def describe_unobservable(
    directions: NDArray[np.float64], names: Sequence[str], share: float = 0.1
) -> str:
    """Return a sentence on the unobservable directions; empty when there are none.

    Args:
        directions: (k, n) orthonormal directions, in column-scaled unknowns.
        names: the n unknowns.
        share: unknowns with a smaller share in these directions are described as weakly affected.

    """
    if len(directions) == 0:
        return ""
    open_share = np.linalg.norm(directions, axis=0)
    strongly = [name for name, part in zip(names, open_share, strict=True) if part > share]
    weakly = [name for name, part in zip(names, open_share, strict=True) if 1e-6 < part <= share]
    noun = "combination" if len(directions) == 1 else "combinations"
    text = f"{len(directions)} {noun} of {', '.join(strongly)} not determined by the motion so far"
    return text + (f"; {', '.join(weakly)} weakly affected" if weakly else "")
