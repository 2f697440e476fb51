"""Other axes in which a log may give a vector: signed ones, and those that two sensors show.

Source: Kabsch 1976, A solution for the best rotation to relate two sets of vectors.
"""

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array

ONE_AXIS = 0.02
"""Products of rates about a second axis, as a share of those about the first, that show a turn."""

MOUNTING = np.radians(3.0)
"""A turn that is nearer to signed axes is an error of a mounting [rad]."""


def signed_axes() -> Iterator[tuple[list[str], Array]]:
    """Yield all other axes, and the matrix M with M v the vector v in these axes."""
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        M = np.zeros((3, 3))
        M[range(3), order] = signs
        if not np.array_equal(M, np.eye(3)):
            yield [("-" if s < 0 else "") + "xyz"[k] for k, s in zip(order, signs)], M


def turn_between(vectors: Array, logged: Array) -> Array | None:
    """Return the rotation M (3, 3) with the least squares of v − M v′ of vectors v and v′ (N, 3).

    None if it is one of `signed_axes`, or if the vectors have one direction only.
    """
    sizes = np.linalg.svd(vectors.T @ logged, compute_uv=False)
    if not sizes[1] > ONE_AXIS * sizes[0]:
        return None
    M = np.asarray(Rotation.align_vectors(vectors, logged)[0].as_matrix())
    signed = [np.eye(3), *(S for _, S in signed_axes())]
    nearest = max(float(np.trace(S.T @ M)) for S in signed)
    return M if nearest < 1 + 2 * np.cos(MOUNTING) else None
