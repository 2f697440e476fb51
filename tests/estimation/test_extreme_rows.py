"""The most probable target of rows of extreme weight: found, or refused, in a moment."""

import numpy as np
import pytest

from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.sensors.suite import SensorSuite


@pytest.fixture
def cone(servicer):
    return Model(servicer.tree, SensorSuite()).cone


def rows_of(psi, weight: float) -> Gaussian:
    """Return rows that give a target with errors of 1 / weight."""
    rows = weight * np.column_stack([np.eye(10), psi])
    return Gaussian.of_rows({PSI: 10}, rows)


@pytest.mark.parametrize("weight", [1e3, 1e12, 1e100])
def test_rows_of_a_body_give_that_body_however_precise_they_are(cone, weight):
    body = 1.5 * cone.solid
    psi = cone.most_probable(rows_of(body, weight))
    np.testing.assert_allclose(psi, body, rtol=0, atol=1e-4 * np.abs(body).max())


@pytest.mark.parametrize("weight", [1e3, 1e12])
def test_rows_of_no_body_end_at_a_body(cone, weight):
    no_body = cone.solid * np.where(np.arange(10) < 4, 1.0, -1.0)
    assert cone.contains(cone.most_probable(rows_of(no_body, weight)))


def test_rows_beyond_what_numbers_hold_are_refused(cone):
    with np.errstate(all="ignore"), pytest.raises(np.linalg.LinAlgError):
        cone.most_probable(rows_of(1e200 * cone.solid, 1e160))
