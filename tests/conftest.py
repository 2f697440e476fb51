"""Shared fixtures: one spacecraft, one target, random motion with and without momentum."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensing_cases import small_craft

from cpid_drake import (
    InertialParameters,
    Motion,
    Spacecraft,
    load_scenario,
    shipped_scenario,
)
from cpid_drake.commands.main import main
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.parameterizations import standard_to_relative
from cpid_drake.dynamics.rotations import rotate

SERVICER = "package://cpid_drake_models/dual_arm_servicer/dual_arm_servicer.urdf"


@pytest.fixture(scope="session")
def servicer() -> Spacecraft:
    return Spacecraft(SERVICER, base="bus", capture_frame="capture_point")


@pytest.fixture(scope="session")
def craft(tmp_path_factory) -> Spacecraft:
    """A small spacecraft with turning and sliding joints, welds and turned frames."""
    return small_craft(tmp_path_factory.mktemp("craft"))


@pytest.fixture
def run_cpid(monkeypatch, capfd):
    """Return a function that runs `cpid`: (code, stdout, stderr)."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["cpid", *map(str, arguments)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, *capfd.readouterr()

    return run


@pytest.fixture
def paper_scenario():
    return load_scenario(shipped_scenario("paper"))


@pytest.fixture(scope="session")
def paper_target() -> InertialParameters:
    return InertialParameters(100.0, [0.4330127, 0.0, 0.0], np.diag([20.0, 30.0, 10.0]))


@pytest.fixture(scope="session")
def skewed_target() -> InertialParameters:
    """A target with every parameter non-zero: nothing hides behind a symmetry."""
    inertia = [[8.0, -0.7, 0.4], [-0.7, 11.0, 0.9], [0.4, 0.9, 6.0]]
    return InertialParameters(60.0, [0.5, -0.12, 0.08], inertia)


@pytest.fixture(scope="session")
def random_motion(servicer):
    """Return a function (n, seed, spacecraft) -> Motion in random states, with momentum."""

    def make(n: int, seed: int, spacecraft: Spacecraft = servicer) -> Motion:
        rng = np.random.default_rng(seed)
        joints = len(spacecraft.joint_names)
        return Motion(
            spacecraft.joint_names,
            np.arange(n, dtype=float),
            quaternion_WB=Rotation.random(n, rng).as_quat(scalar_first=True),
            p_WB=rng.normal(size=(n, 3)),
            w_WB=0.2 * rng.normal(size=(n, 3)),
            v_WB=0.2 * rng.normal(size=(n, 3)),
            q=rng.uniform(-2.0, 2.0, size=(n, joints)),
            qdot=0.3 * rng.normal(size=(n, joints)),
        )

    return make


@pytest.fixture(scope="session")
def zero_momentum_motion(servicer, random_motion):
    """Return a function (target, n, seed) -> Motion in random states of zero momentum."""

    def make(target: InertialParameters, n: int, seed: int) -> Motion:
        telemetry = random_motion(n, seed)
        known = BodyDynamics.at(servicer.tree, telemetry.q, telemetry.qdot)
        twist = known.base_twist(standard_to_relative(target.to_standard_vector(), known.mass))
        w_WB, v_WB = (rotate(telemetry.R_WB, part) for part in twist)
        return replace(telemetry, w_WB=w_WB, v_WB=v_WB)

    return make
