"""Estimates from growing parts of a log, made in the same way as that from all samples."""

from dataclasses import replace

import numpy as np
import pytest

from cpid_drake.identification.estimators import ESTIMATORS
from cpid_drake.identification.identify_files import converge, identify_files
from cpid_drake.identification.request import Request, SpacecraftReference


@pytest.mark.slow
def test_errors_of_the_spacecraft_limit_the_first_estimates_too(monkeypatch):
    """More samples tell more: no earlier interval is narrower than the last one."""
    record = replace(ESTIMATORS["trajectory_fit"], reports=3)
    monkeypatch.setitem(ESTIMATORS, "trajectory_fit", record)
    craft = SpacecraftReference(
        "package://cpid_drake_models/free_flyer/free_flyer.urdf", "body", "capture_point"
    )
    request = Request(
        "package://cpid_drake_models/telemetry/free_flyer.csv",
        craft,
        sensors="testbed",
        known_bodies="mass=0.01,com=0.002,inertia=0.01",
        end=6.0,
    )
    found = converge(identify_files([request]))
    width = np.array([np.ptp(each.intervals, axis=1) for _, each in found])
    assert [time for time, _ in found] == [2.0, 4.0, 6.0]
    assert (width > 0.99 * width[-1]).all()
