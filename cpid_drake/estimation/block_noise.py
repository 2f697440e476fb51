"""What each block alone shows of the sensors' noise; see `spectrum`."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular

from cpid_drake.array import Array
from cpid_drake.estimation.block_rows import BlockRows
from cpid_drake.estimation.least_squares import triangle
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Rolled, Values
from cpid_drake.estimation.spectrum import added, spectrum_of
from cpid_drake.estimation.sweep import OPEN, linearized
from cpid_drake.estimation.unknowns import Model
from cpid_drake.sensors.sensors import SENSORS


def with_spectra(model: Model, log: LogState, rolled: Rolled, values: Values) -> LogState:
    """Return a log with the spectra that its blocks show, and those before them.

    Args:
        model: the unknowns.
        log: a log; what blocks have shown stays.
        rolled: its prediction at the values.
        values: of all unknowns.

    """
    if log.shown:
        return log
    rows = linearized(model.of_log(log.name), log, rolled, values, forward_only=False)
    shown = tuple(map(_shown, rolled.models, rows, rolled.residuals))
    sums = added(log.past.shown if log.past else {}, *shown)
    spectra = {name: spectrum_of(each) for name, each in sums.items()}
    return replace(log, shown=shown, spectra=spectra)


def _shown(part: BlockModel, own: BlockRows, residuals: Mapping[str, Array]) -> dict[str, Array]:
    """Return what a block shows whatever its own unknowns are; what outlives it stays."""
    assert own.samples is not None
    c = len(part.at_end) + len(own.gone)
    wide = np.eye(c, c + 1) / OPEN  # what nothing shows
    T = triangle(np.vstack([np.column_stack([np.triu(own.T[:c, :c]), own.T[:c, -1]]), wide]))
    Q = solve_triangular(T[:c, :c], own.samples[:, :c].T, trans="T").T
    rest, found, first = own.samples[:, -1] - Q @ T[:c, c], {}, 0
    for name, each in residuals.items():
        rows = slice(first, first + each.size)
        first += each.size
        if name in SENSORS:  # the mean of a white force has no spectrum
            by = Q[rows].reshape(*each.shape, -1)
            found[name] = own.whitening[name].sums(by, rest[rows].reshape(each.shape))
    return found
