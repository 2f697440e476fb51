"""A user's own plant behind `MomentumIdentifier`: refused, or a world whose momentum is checked."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    QuaternionFloatingJoint,
    RevoluteJoint,
    RpyFloatingJoint,
    SpatialInertia,
)
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    ConstantVectorSource,
    LogVectorOutput,
    TrajectorySource,
    ZeroOrderHold,
)
from pydrake.trajectories import PiecewisePolynomial

from cpid_drake import (
    InertialParameters,
    InputError,
    MomentumIdentifier,
    Spacecraft,
    identify,
    models_directory,
)

FLYER = "package://cpid_drake_models/free_flyer/free_flyer.urdf"
TARGET = InertialParameters(8.5, [0.05, -0.02, 0.1], np.diag([0.2, 0.25, 0.15]))
END = 4.0
PERIODS = {4: 1.0, 10: 0.4, 100: 0.04}
"""Time between samples, by their number [s]."""


@pytest.fixture(scope="module")
def flyer() -> Spacecraft:
    return Spacecraft(FLYER, base="body", capture_frame="capture_point")


def parsed(plant: MultibodyPlant, prefix: str = "") -> None:
    """Parse the free-flyer into a plant as a user does."""
    parser = Parser(plant, prefix) if prefix else Parser(plant)
    parser.package_map().AddPackageXml(str(models_directory() / "package.xml"))
    parser.AddModels(url=FLYER)


def own_plant(time_step: float = 0.0, *, gravity: bool = False) -> MultibodyPlant:
    """Return a user's plant of the free-flyer with the target."""
    plant = MultibodyPlant(time_step)
    parsed(plant)
    body = plant.AddRigidBody("load", plant.AddModelInstance("load"), TARGET.to_spatial_inertia())
    plant.WeldFrames(plant.GetFrameByName("capture_point"), body.body_frame())
    if not gravity:
        plant.mutable_gravity_field().set_gravity_vector([0, 0, 0])
    plant.Finalize()
    return plant


def run(
    flyer: Spacecraft, plant: MultibodyPlant, config: SimulatorConfig
) -> tuple[dict[tuple[str, int], MomentumIdentifier], object]:
    """Return identifiers by rows and samples, behind a hold, and the Context at the end."""
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    joints = plant.num_velocities() - 6
    efforts = np.vstack(
        [np.zeros((6, 5)), 0.02 * np.random.default_rng(4).normal(size=(joints, 5))]
    )
    efforts[:, -1] = 0.0
    torque = PiecewisePolynomial.CubicShapePreserving(np.linspace(0, END, 5), efforts)
    source = builder.AddSystem(TrajectorySource(torque))
    builder.Connect(source.get_output_port(), plant.get_applied_generalized_force_input_port())
    hold = builder.AddSystem(ZeroOrderHold(0.04, plant.num_multibody_states()))
    builder.Connect(plant.get_state_output_port(), hold.get_input_port())
    identifiers = {}
    for rows in ("eq18", "standard"):
        for count, period in PERIODS.items():
            options = {"rows": rows, "period": period, "offset": period}
            identifiers[rows, count] = MomentumIdentifier.AddToBuilder(
                builder, flyer, state=hold.get_output_port(), **options
            )
            identifiers[rows, count].set_name(f"{rows} {count}")
    simulator = Simulator(builder.Build())
    ApplySimulatorConfig(config, simulator)
    simulator.AdvanceTo(END)
    simulator.AdvancePendingEvents()
    return identifiers, simulator.get_context()


def fixed(scheme: str, step: float) -> SimulatorConfig:
    return SimulatorConfig(
        integration_scheme=scheme, max_step_size=step, use_error_control=False, accuracy=0.1
    )


WORLDS = {
    "discrete 1e-2": (own_plant, 1e-2, SimulatorConfig()),
    "discrete 1e-3": (own_plant, 1e-3, SimulatorConfig()),
    "discrete 1e-4": (own_plant, 1e-4, SimulatorConfig()),
    "explicit Euler 1e-3": (own_plant, 0.0, fixed("explicit_euler", 1e-3)),
    "implicit Euler 1e-3": (own_plant, 0.0, fixed("implicit_euler", 1e-3)),
    "gravity": (lambda step: own_plant(step, gravity=True), 0.0, SimulatorConfig(accuracy=1e-8)),
    "accuracy 1e-4": (own_plant, 0.0, SimulatorConfig(accuracy=1e-4)),
    "accuracy 1e-6": (own_plant, 0.0, SimulatorConfig(accuracy=1e-6)),
    "accuracy 1e-8": (own_plant, 0.0, SimulatorConfig(accuracy=1e-8)),
}


@pytest.mark.parametrize("kind", WORLDS)
def test_a_world_without_conservation_never_passes_with_a_wrong_target(flyer, kind):
    """Behind a hold the plant cannot be asked: the rows themselves show what is not conserved."""
    make, step, config = WORLDS[kind]
    identifiers, context = run(flyer, make(step), config)
    for (_, count), identifier in identifiers.items():
        result = identifier.identification(context)
        passed = identifier.GetOutputPort("checks_passed").Eval(
            identifier.GetMyContextFromRoot(context)
        )[0]
        assert result.sample_count == count
        if passed:
            error = np.abs(result.parameters - TARGET.to_vector())
            assert (error < 3.5 * np.sqrt(np.diag(result.covariance))).all()
        if kind.startswith("accuracy") and config.accuracy <= 1e-6:
            assert passed
        elif not kind.endswith("1e-4"):
            assert not passed
            assert "is not conserved: the rows miss it by" in "; ".join(result.failures)


@pytest.mark.parametrize("scheme", ["explicit_euler", "implicit_euler"])
def test_steps_that_change_the_norm_of_the_quaternion_are_refused(flyer, scheme):
    with pytest.raises(InputError, match=r"eq18.*unit norm.*the steps of an integrator"):
        run(flyer, own_plant(), fixed(scheme, 1e-2))


@pytest.mark.parametrize("kind", ["discrete 1e-3", "accuracy 1e-8"])
@pytest.mark.parametrize("rows", ["eq18", "standard"])
def test_a_log_of_such_a_world_is_checked_alike(flyer, kind, rows):
    make, step, config = WORLDS[kind]
    plant = make(step)
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    joints = plant.num_velocities() - 6
    efforts = 0.05 * np.random.default_rng(4).normal(size=(joints, 3))
    torque = PiecewisePolynomial.CubicShapePreserving(
        [0.0, END / 2, END], np.vstack([np.zeros((6, 3)), efforts])
    )
    source = builder.AddSystem(TrajectorySource(torque))
    builder.Connect(source.get_output_port(), plant.get_applied_generalized_force_input_port())
    log = LogVectorOutput(plant.get_state_output_port(), builder, publish_period=0.1)
    simulator = Simulator(builder.Build())
    ApplySimulatorConfig(config, simulator)
    simulator.AdvanceTo(END / 2)
    simulator.Initialize()  # the state at this time is logged twice
    simulator.AdvanceTo(END)
    states = log.FindLog(simulator.get_context())
    assert len(np.unique(states.sample_times())) < len(states.sample_times())
    motion = flyer.to_motion(states.sample_times(), states.data().T)
    result = identify(flyer, motion, estimator="least_squares", rows=rows, momentum="zero")
    error = np.abs(result.parameters - TARGET.to_vector())
    assert result.passed == kind.startswith("accuracy")
    assert (error < 3.5 * np.sqrt(np.diag(result.covariance))).all() or not result.passed


def test_states_of_one_time_that_differ_are_refused(flyer):
    state = np.zeros(flyer.plant.num_multibody_states())
    state[0] = 1.0
    with pytest.raises(InputError, match="time does not increase at sample 1"):
        flyer.to_motion([1.0, 1.0], [state, state + np.eye(len(state))[6]])


# -- what the plant says -------------------------------------------------------------------------


def added(flyer: Spacecraft, plant: MultibodyPlant, port=None) -> MomentumIdentifier:
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    state = plant.get_state_output_port() if port is None else port(plant)
    return MomentumIdentifier.AddToBuilder(builder, flyer, state=state)


def of_base(joint: type) -> MultibodyPlant:
    """Return a plant whose base is on a joint that the user declared."""
    plant = MultibodyPlant(0.0)
    parsed(plant)
    frames = plant.world_frame(), plant.GetFrameByName("body")
    plant.AddJoint(joint("base", *frames))
    plant.mutable_gravity_field().set_gravity_vector([0, 0, 0])
    plant.Finalize()
    return plant


def two_of_a_kind() -> MultibodyPlant:
    """Return a plant of two free-flyers and debris, the second one in other states first."""
    plant = MultibodyPlant(0.0)
    plant.AddRigidBody(
        "debris", plant.AddModelInstance("debris"), SpatialInertia.SolidSphereWithMass(3.0, 0.2)
    )
    for prefix in ("chaser", "helper"):
        parsed(plant, prefix)
    plant.mutable_gravity_field().set_gravity_vector([0, 0, 0])
    plant.Finalize()
    return plant


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: own_plant(1e-3), r"discrete \(time_step = 0.001 s\).*time_step=0.0"),
        (lambda: own_plant(gravity=True), r"gravity of 9.81 m/s².*set_gravity_vector"),
        (lambda: of_base(RpyFloatingJoint), "'body' must float freely .* not with roll, pitch"),
        (two_of_a_kind, r"'body' in chaser::free_flyer, helper::free_flyer.*get_state_output_port"),
    ],
)
def test_a_plant_that_does_not_fit_is_refused_with_the_remedy(flyer, make, message):
    with pytest.raises(InputError, match=message):
        added(flyer, make())


def test_another_craft_is_refused(flyer, servicer):
    with pytest.raises(InputError, match="has no 'body' of the spacecraft model"):
        added(flyer, servicer.make_simulation_plant(TARGET))


def test_a_craft_with_more_joints_is_refused(flyer):
    plant = MultibodyPlant(0.0)
    parsed(plant)
    panel = plant.AddRigidBody(
        "panel",
        plant.GetModelInstanceByName("free_flyer"),
        SpatialInertia.SolidSphereWithMass(1.0, 0.2),
    )
    plant.AddJoint(
        RevoluteJoint("hinge", plant.GetFrameByName("body"), panel.body_frame(), [0, 0, 1])
    )
    plant.mutable_gravity_field().set_gravity_vector([0, 0, 0])
    plant.Finalize()
    with pytest.raises(InputError, match=r"hinge.* another spacecraft"):
        added(flyer, plant)


def test_the_base_may_have_a_joint_with_a_name(flyer):
    added(flyer, of_base(QuaternionFloatingJoint))


@pytest.mark.parametrize("whole", [False, True], ids=["port of the instance", "port of the plant"])
def test_its_own_columns_are_taken_from_a_plant_with_more_bodies(flyer, whole):
    """Rows of the spacecraft's own state, whatever the others do."""
    plant = MultibodyPlant(0.0)
    plant.AddRigidBody(
        "debris", plant.AddModelInstance("debris"), SpatialInertia.SolidSphereWithMass(3.0, 0.2)
    )
    parsed(plant, "helper")
    parsed(plant)
    plant.mutable_gravity_field().set_gravity_vector([0, 0, 0])
    plant.Finalize()
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    instance = plant.GetModelInstanceByName("free_flyer")
    state = plant.get_state_output_port() if whole else plant.get_state_output_port(instance)
    identifier = MomentumIdentifier.AddToBuilder(builder, flyer, state=state, offset=0.0)
    simulator = Simulator(builder.Build())
    rng, context = np.random.default_rng(2), simulator.get_mutable_context()
    theirs = plant.GetMyMutableContextFromRoot(context)
    x = rng.normal(size=plant.num_multibody_states())
    plant.SetPositionsAndVelocities(theirs, x)
    for name in ("debris", "helper::free_flyer", "free_flyer"):
        body = "debris" if name == "debris" else "body"
        body = plant.GetBodyByName(body, plant.GetModelInstanceByName(name))
        plant.SetFloatingBaseBodyPoseInWorldFrame(theirs, body, RigidTransform(rng.normal(size=3)))
    own = plant.GetPositionsAndVelocities(theirs, instance)
    simulator.AdvancePendingEvents()
    alone = MomentumIdentifier(flyer, offset=0.0)
    other = alone.CreateDefaultContext()
    alone.GetInputPort("state").FixValue(other, own)
    other.get_mutable_discrete_state().SetFrom(alone.EvalUniquePeriodicDiscreteUpdate(other))
    mine = identifier.GetMyContextFromRoot(context)
    for k in range(2):
        np.testing.assert_array_equal(
            mine.get_discrete_state(k).value(), other.get_discrete_state(k).value()
        )


# -- runs ----------------------------------------------------------------------------------------


def diagram(flyer: Spacecraft, **options) -> tuple[Simulator, MultibodyPlant, MomentumIdentifier]:
    plant, builder = own_plant(), DiagramBuilder()
    builder.AddSystem(plant)
    port = plant.get_applied_generalized_force_input_port()
    force = np.append(np.zeros(6), [0.02, -0.03, 0.02, -0.01][: plant.num_velocities() - 6])
    source = builder.AddSystem(ConstantVectorSource(force))
    builder.Connect(source.get_output_port(), port)
    identifier = MomentumIdentifier.AddToBuilder(
        builder, flyer, state=plant.get_state_output_port(), **options
    )
    simulator = Simulator(builder.Build())
    ApplySimulatorConfig(SimulatorConfig(accuracy=1e-8, max_step_size=0.05), simulator)
    return simulator, plant, identifier


def test_runs_add_up_where_time_is_set_back(flyer):
    """Three runs of a second from other poses of the arm, as with a robot's short tests."""
    simulator, plant, identifier = diagram(flyer, period=1.0)
    context = simulator.get_mutable_context()
    for k in range(3):
        context.SetTime(0.0)
        theirs = plant.GetMyMutableContextFromRoot(context)
        state = np.zeros(plant.num_multibody_states())
        state[0], state[7 + k] = 1.0, 0.4
        plant.SetPositionsAndVelocities(theirs, state)
        simulator.Initialize()
        simulator.Initialize()
        simulator.AdvanceTo(1.0)
        assert identifier.Finish(context).sample_count == k + 1
    result = identifier.identification(context)
    np.testing.assert_allclose(result.parameters, TARGET.to_vector(), rtol=0, atol=1e-4)


def test_reading_in_the_middle_changes_nothing(flyer):
    states = []
    for reads in (False, True):
        simulator, _, identifier = diagram(flyer, period=0.1, offset=0.0)
        for time in np.arange(0.0, 2.05, 0.1 if reads else 2.0):
            simulator.AdvanceTo(time)
            if reads:
                identifier.identification(simulator.get_context())
        identifier.Finish(simulator.get_mutable_context())
        own = identifier.GetMyContextFromRoot(simulator.get_context())
        states.append(np.concatenate([own.get_discrete_state(k).value() for k in range(3)]))
    np.testing.assert_array_equal(*states)


def test_zeros_before_the_first_value_of_a_hold_are_no_sample(flyer):
    plant, builder = own_plant(), DiagramBuilder()
    builder.AddSystem(plant)
    force = builder.AddSystem(ConstantVectorSource(np.zeros(plant.num_velocities())))
    builder.Connect(force.get_output_port(), plant.get_applied_generalized_force_input_port())
    hold = builder.AddSystem(ZeroOrderHold(1.0, plant.num_multibody_states(), 0.5))
    builder.Connect(plant.get_state_output_port(), hold.get_input_port())
    identifier = MomentumIdentifier.AddToBuilder(
        builder, flyer, state=hold.get_output_port(), period=1.0, offset=0.0
    )
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(3.0)
    assert identifier.Finish(simulator.get_mutable_context()).sample_count == 3  # 1, 2 and 3 s
