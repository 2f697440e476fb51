"""Independent streams of random numbers, which a seed and a key determine."""

import numpy as np


def random_stream(seed: int, *key: int) -> np.random.Generator:
    """Return the generator of one stream; it differs from `numpy.random.default_rng(seed)`.

    Args:
        seed: a whole number >= 0.
        key: whole numbers >= 0. Keys of different length never give the same stream:
            (number in the table of sensors) for errors that differ from sample to sample,
            (number in the table, kind) for constant errors of a sensor, and three numbers for
            disturbances.

    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
