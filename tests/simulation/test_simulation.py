"""A scenario as a Diagram: momentum is conserved, and what is simulated is identified."""

from dataclasses import replace

import numpy as np
import pytest
from flyer_cases import MOVING, payload
from pydrake.multibody.tree import BodyIndex, JointIndex

from cpid_drake import (
    InertialParameters,
    InputError,
    JointController,
    load_scenario,
    make_simulation,
    shipped_scenario,
)
from cpid_drake.dynamics.momentum import system_momentum
from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.dynamics.propagation import Wrench, propagate
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.sensors import JointSensor
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.simulation.flexible import SprungMass
from cpid_drake.simulation.scenario import ControllerConfig, DisturbanceConfig
from cpid_drake.simulation.trials import base_trajectory, make_case

DISTURBANCE = DisturbanceConfig(np.array([4e-3, -3e-3, 2e-3]), np.array([0.01, 0.02, -0.03]))


class Swinging:
    """A motion that does not start at rest."""

    duration = 4.0

    def __init__(self, joints: int) -> None:
        self.amplitude = np.linspace(0.2, 0.5, joints)

    def breaks(self):
        return np.array([0.0, self.duration])

    def evaluate(self, time):
        t = np.asarray(time, dtype=float)[..., None]
        w = np.linspace(0.5, 1.5, self.amplitude.size)
        a = self.amplitude
        return np.stack([a * np.sin(w * t), a * w * np.cos(w * t), -a * w**2 * np.sin(w * t)], -2)


def test_a_motion_that_starts_moving_needs_the_right_base_twist(servicer, skewed_target):
    """With it the system has no momentum; with a base at rest it has."""
    motion = Swinging(12)
    state = servicer.initial_state(skewed_target, motion)
    columns = servicer.state_columns["qdot"]
    np.testing.assert_allclose(state[columns], motion.evaluate(0.0)[1])
    plant = servicer.make_simulation_plant(skewed_target)
    context = plant.CreateDefaultContext()
    plant.SetPositionsAndVelocities(context, state)
    momentum = plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3)).get_coeffs()
    assert np.abs(momentum).max() < 1e-11

    base = np.arange(plant.num_positions(), plant.num_positions() + 6)
    state[base] = 0.0
    plant.SetPositionsAndVelocities(context, state)
    momentum = plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3)).get_coeffs()
    assert np.abs(momentum).max() > 1.0


# -- sensors -------------------------------------------------------------------------------------


def test_the_online_estimate_includes_the_uncertainty_of_the_spacecraft():
    """The grasp is known to 20 mm, and the centre of mass in C not better."""
    scenario = load_scenario(shipped_scenario("exciting_motion"))
    scenario.sensors.suite = "flight"
    scenario.identification = replace(scenario.identification, estimator="recursive_fit", rows=None)
    scenario.known_bodies = BodyUncertainty(grasp_mm=20.0)
    scenario.simulation.duration = 1.5
    scenario.simulation.simulator.accuracy = 1e-5
    simulation = make_simulation(scenario)
    covariance = simulation.identification(simulation.run()).covariance
    assert (np.sqrt(np.diag(covariance))[1:4] > 0.019).all()


def test_a_controller_has_the_gains_and_the_sphere_of_its_scenario(servicer):
    """Its efforts are those of a controller made by hand, off the motion and in motion."""
    scenario = load_scenario(shipped_scenario("paper"))
    scenario.controller = ControllerConfig(False, 60.0, 0.7, 3.0, 0.6)
    simulation = make_simulation(scenario)
    root = simulation.diagram.CreateDefaultContext()
    state = simulation.plant.GetPositionsAndVelocities(
        simulation.plant.GetMyContextFromRoot(root)
    ).copy()
    q, v = (servicer.state_columns[name] for name in ("q", "qdot"))
    state[q] += 0.1
    state[v] -= 0.2
    simulation.plant.SetPositionsAndVelocities(
        simulation.plant.GetMyMutableContextFromRoot(root), state
    )
    system = simulation.diagram.GetSubsystemByName("joint_controller")
    found = system.GetOutputPort("generalized_force").Eval(system.GetMyContextFromRoot(root))

    sphere = InertialParameters(60.0, np.zeros(3), 0.4 * 60.0 * 0.7**2 * np.eye(3))
    by_hand = JointController(servicer, target=sphere, natural_frequency=3.0, damping_ratio=0.6)
    context = by_hand.CreateDefaultContext()
    desired = simulation.joint_motion.evaluate(0.0).ravel()
    by_hand.GetInputPort("state").FixValue(context, state)
    by_hand.GetInputPort("desired_motion").FixValue(context, desired)
    np.testing.assert_allclose(
        found, by_hand.GetOutputPort("generalized_force").Eval(context), rtol=1e-12, atol=1e-12
    )
    assert np.abs(found).max() > 1.0


@pytest.mark.parametrize("walk", [0.0, pytest.param(1e-5, marks=pytest.mark.slow)])
def test_a_disturbance_changes_the_momentum_as_newtons_laws_say(walk):
    """The plant gets the force and the torque; the momentum that they give has a closed form."""
    scenario = payload(2.0, 1e-9, momentum_W=MOVING, disturbance=DISTURBANCE)
    scenario.sensors.explicit = SensorSuite(
        encoders=JointSensor(),
        disturbances=Disturbances(1e-3, 1e-2, acceleration_walk=walk, torque_walk=100 * walk),
    )
    scenario.identification.estimator = "least_squares"
    simulation = make_simulation(scenario)
    context = simulation.run()
    telemetry = simulation.motion(context)
    P, L = system_momentum(simulation.spacecraft.tree, simulation.truth, telemetry)
    expected = simulation.expected_momentum(context)
    np.testing.assert_allclose(np.hstack([L, P]), expected, atol=2e-7)
    np.testing.assert_allclose(P[-1] - P[0], expected[-1, 3:] - expected[0, 3:], atol=1e-7)
    if not walk:
        mass = simulation.spacecraft.mass + simulation.truth.mass
        push = scenario.simulation.disturbance.acceleration_W
        np.testing.assert_allclose(P[-1] - P[0], 2.0 * mass * push, atol=1e-7)


def test_an_orbit_turns_and_moves_the_plant_as_it_does_the_base():
    """Forces on every body of the plant; the base's motion is integrated by its momentum."""
    scenario = payload(2.0, 1e-8, momentum_W=MOVING, disturbance=DISTURBANCE)
    orbit = Orbit(rate=0.1, nadir_W=np.array([0.6, 0, -0.8]), normal_W=np.array([0.8, 0, 0.6]))
    scenario.sensors.explicit = SensorSuite(
        encoders=JointSensor(), disturbances=Disturbances(orbit=orbit)
    )
    scenario.identification.estimator = "least_squares"
    simulation = make_simulation(scenario)
    context = simulation.run()
    telemetry = simulation.motion(context)
    P, L = system_momentum(simulation.spacecraft.tree, simulation.truth, telemetry)
    expected = simulation.expected_momentum(context)
    np.testing.assert_allclose(np.hstack([L, P]), expected, rtol=0, atol=1e-6)
    base = propagate(
        simulation.spacecraft.tree,
        simulation.joint_motion,
        simulation.truth.to_standard_vector(),
        telemetry.time,
        momentum_W=scenario.simulation.momentum_W,
        wrench=lambda time: Wrench([0.01, 0.02, -0.03, 4e-3, -3e-3, 2e-3], orbit=orbit),
        max_step=0.02,
    )
    end = base.momentum_W[-1]
    # The joints do not follow the desired motion exactly.
    np.testing.assert_allclose(np.hstack([L, P])[-1], end, rtol=0, atol=1e-4)
    np.testing.assert_allclose(telemetry.p_WB, base.p_WB, rtol=0, atol=1e-4)
    assert np.abs(end - expected[0]).max() > 1e-2


def with_slosh(frequency: float, damping_ratio: float = 0.05, accuracy: float = 1e-9):
    masses = [
        SprungMass("body", np.array([0.05, 0.1, -0.08]), 1.0, frequency, damping_ratio),
        SprungMass(
            "captured_target", np.array([0.3, 0.05, 0.05]), 0.5, 2 * frequency, damping_ratio
        ),
    ]
    push = DisturbanceConfig(DISTURBANCE.acceleration_W)
    return payload(1.5, accuracy, momentum_W=MOVING, disturbance=push, sprung_masses=masses)


@pytest.fixture(scope="module")
def sloshing():
    simulation = make_simulation(with_slosh(0.5))
    return simulation, simulation.run()


def test_sprung_masses_conserve_momentum(sloshing):
    """That of all bodies, as Drake computes it; the rigid model exchanges some with the masses."""
    simulation, context = sloshing
    telemetry, expected = simulation.motion(context), simulation.expected_momentum(context)
    np.testing.assert_allclose(simulation.momentum(context), expected, rtol=0, atol=1e-7)
    P, L = system_momentum(simulation.spacecraft.tree, simulation.truth, telemetry)
    exchanged = np.abs(np.hstack([L, P]) - expected)
    assert exchanged.max() > 1e-3
    assert exchanged[0].max() < 1e-12, "they start at rest in their bodies"


def test_a_mass_on_a_spring_swings_with_its_frequency_and_damping():
    """Held by a heavy body, as exp(−ζωt); at rest, mass and inertia are those of the model."""
    light = SprungMass("body", np.array([0.05, 0.1, -0.08]), 1e-3, 0.5, 0.05)
    scenario = payload(10.0, 1e-9, sprung_masses=[light])
    plant = make_simulation(scenario).plant
    context = plant.CreateDefaultContext()
    scenario.simulation.sprung_masses = []
    rigid = make_simulation(scenario).plant
    whole, expected = (
        p.CalcSpatialInertia(c, p.world_frame(), [BodyIndex(k) for k in range(1, p.num_bodies())])
        for p, c in ((plant, context), (rigid, rigid.CreateDefaultContext()))
    )
    np.testing.assert_allclose(whole.CopyToFullMatrix6(), expected.CopyToFullMatrix6(), atol=1e-12)
    w = 2 * np.pi * 0.5
    for axis in "xyz":
        [joint] = [
            plant.get_joint(JointIndex(k))
            for k in range(plant.num_joints())
            if "sprung_mass" in plant.get_joint(JointIndex(k)).name()
            and plant.get_joint(JointIndex(k)).name().endswith(f"_{axis}")
        ]
        port = plant.get_generalized_acceleration_output_port()
        joint.set_translation(context, 0.01)
        by_place = port.Eval(context)[joint.velocity_start()]
        joint.set_translation(context, 0.0)
        joint.set_translation_rate(context, 0.01)
        by_rate = port.Eval(context)[joint.velocity_start()]
        joint.set_translation_rate(context, 0.0)
        np.testing.assert_allclose(by_place, -(w**2) * 0.01, rtol=1e-2)
        np.testing.assert_allclose(by_rate, -2 * 0.05 * w * 0.01, rtol=1e-2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"body": "bodie"}, "no RigidBody named 'bodie'"),
        ({"mass": 20.0}, "a sprung mass of 20 kg in body: no mass remains"),
        ({"p_BS": np.array([3.0, 0.0, 0.0])}, "a sprung mass of 1 kg in body: "),
    ],
)
def test_a_sprung_mass_that_its_body_cannot_contain_is_refused(change, message):
    scenario = with_slosh(0.5)
    first = scenario.simulation.sprung_masses[0]
    scenario.simulation.sprung_masses = [replace(first, **change)]
    with pytest.raises(InputError, match=message):
        make_simulation(scenario)


@pytest.mark.slow
def test_a_table_holds_height_and_tilt_and_nothing_in_the_plane():
    """A target above the plane would tilt a free base; on a table it moves as the planar model."""
    scenario = load_scenario(shipped_scenario("air_bearing"))
    scenario.simulation.duration = 3.0
    scenario.simulation.simulator.accuracy = 1e-8
    scenario.simulation.disturbance = DisturbanceConfig(
        np.array([4e-3, 3e-3, -5e-3]), np.array([2e-3, -1e-3, 1e-3])
    )
    scenario.target.p_CTcm_C = np.array([0.115, 0.015, 0.08])
    scenario.target.I_TTcm_C = np.array(
        [[0.02, 0.001, 0.003], [0.001, 0.022, -0.002], [0.003, -0.002, 0.024]]
    )
    simulation = make_simulation(scenario)
    context = simulation.run()
    telemetry = simulation.motion(context)
    assert np.abs(telemetry.p_WB[:, 2]).max() < 1e-4
    tilt = telemetry.R_WB[:, :2, 2]
    assert np.abs(tilt).max() < 1e-4
    P, L = system_momentum(simulation.spacecraft.tree, simulation.truth, telemetry)
    expected = simulation.expected_momentum(context)
    np.testing.assert_allclose(P[:, :2], expected[:, 3:5], atol=1e-6)
    np.testing.assert_allclose(L[:, 2], expected[:, 2], atol=2e-6)
    case = make_case(scenario, simulation.spacecraft, simulation.truth, scenario.make_suite(), 1)
    base = base_trajectory(case, simulation.spacecraft.tree, telemetry.time)
    np.testing.assert_allclose(telemetry.p_WB[:, :2], base.p_WB[:, :2], atol=2e-5)
    free = replace(scenario.spacecraft, on_table=False)
    loose = make_simulation(replace(scenario, spacecraft=free))
    tilted = loose.motion(loose.run()).R_WB[:, :2, 2]
    assert np.abs(tilted).max() > 30 * np.abs(tilt).max()
