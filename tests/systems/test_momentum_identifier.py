"""The identifier in a diagram: state in the Context, NaN until identifiable, equal to batch."""

from dataclasses import replace

import numpy as np
import pytest
from planar_cases import planar_craft
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from sensing_cases import small_craft, true_telemetry

from cpid_drake import HalfCosine, InputError, MomentumIdentifier, identify
from cpid_drake.dynamics.rows import row_family
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.momentum_rows import momentum_rows


@pytest.fixture(scope="module")
def motion(skewed_target, zero_momentum_motion):
    return zero_momentum_motion(skewed_target, 10, seed=41)


def take(identifier, context, state) -> None:
    """Let the identifier take one sample of a state, a second later."""
    context.SetTime(context.get_time() + 1.0)
    identifier.GetInputPort("state").FixValue(context, state)
    update = identifier.EvalUniquePeriodicDiscreteUpdate(context)
    context.get_mutable_discrete_state().SetFrom(update)


def outputs(identifier, context) -> dict:
    names = ("parameters", "covariance", "diagnostics")
    return {name: identifier.GetOutputPort(name).Eval(context) for name in names}


@pytest.mark.parametrize("rows", ["eq18", "standard"])
def test_estimate_is_nan_until_identifiable_and_says_so(servicer, motion, skewed_target, rows):
    identifier = MomentumIdentifier(servicer, rows=rows)
    context = identifier.CreateDefaultContext()
    for count, state in enumerate(servicer.to_states(motion), start=1):
        take(identifier, context, state)
        values, result = outputs(identifier, context), identifier.identification(context)
        samples, rank, condition, _ = values["diagnostics"]
        inertia = identifier.GetOutputPort("spatial_inertia").Eval(context)
        assert samples == count
        if count < 3:
            assert rank == {1: 6, 2: 9}[count]
            assert condition == np.inf
            assert np.isnan(values["parameters"]).any()
            is_open = np.isnan(values["parameters"])
            covariance = values["covariance"].reshape(10, 10)
            assert np.isnan(covariance[is_open]).all()
            assert np.isnan(covariance[:, is_open]).all()
            assert inertia.IsNaN()
            assert "Not identifiable" in result.explain()
            with pytest.raises(InputError, match="Not identifiable"):
                result.raw()
        else:
            assert rank == 10
            np.testing.assert_allclose(
                values["parameters"], skewed_target.to_vector(), rtol=0, atol=1e-9
            )
            assert inertia.IsPhysicallyValid()
            assert "10 of 10" in result.explain()


@pytest.mark.parametrize("rows", ["eq18", "standard"])
def test_online_equals_batch(servicer, motion, rows):
    """The estimate to 1e-9 relative; the covariance has one variance of all rows."""
    noise = 1e-5 * np.random.default_rng(1).normal(size=(2, len(motion), 3))
    noisy = replace(motion, w_WB=motion.w_WB + noise[0], v_WB=motion.v_WB + noise[1])
    identifier = MomentumIdentifier(servicer, rows=rows)
    context = identifier.CreateDefaultContext()
    for state in servicer.to_states(noisy):
        take(identifier, context, state)
    batch = identify(servicer, noisy, rows=rows, momentum=TotalMomentum.zero())
    values = outputs(identifier, context)
    np.testing.assert_allclose(values["parameters"], batch.parameters, rtol=1e-9, atol=1e-12)
    covariance = values["covariance"].reshape(10, 10)
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9)
    assert (np.linalg.eigvalsh(covariance) > 0).all()


def level(motion):
    """Return a motion with what a table leaves of it: turns about its normal, and slides."""
    angle = np.linspace(0.0, 2.0, len(motion))
    turn = np.column_stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)])
    return replace(
        motion,
        quaternion_WB=turn,
        p_WB=motion.p_WB * [1, 1, 0],
        v_WB=motion.v_WB * [1, 1, 0],
        w_WB=motion.w_WB * [0, 0, 1],
    )


@pytest.mark.parametrize("kind", ["free", "wheels", "table"])
@pytest.mark.parametrize("rows", ["standard", "relative"])
def test_rows_of_the_plant_are_those_of_the_kinematics_of_a_batch(
    tmp_path, random_motion, kind, rows
):
    """The information RᵀR of Drake's momentum, and of the package's own tree of joints."""
    craft = small_craft(tmp_path, wheels=kind == "wheels")
    motion = random_motion(6, 3, craft)
    if kind == "table":
        craft = planar_craft(tmp_path).on_table()
        motion = level(random_motion(6, 3, craft))
    momentum = TotalMomentum.unknown()
    identifier = MomentumIdentifier(craft, rows=rows, momentum=momentum)
    context = identifier.CreateDefaultContext()
    for state in craft.to_states(motion):
        take(identifier, context, state)
    expected = momentum_rows(craft.tree, motion, row_family(rows), momentum)
    size = expected.shape[1]
    R = np.triu(context.get_discrete_state(0).value().reshape(size, size))
    unit = np.linalg.norm(expected, axis=0) + 1e-3
    np.testing.assert_allclose(
        R.T @ R / unit / unit[:, None], expected.T @ expected / unit / unit[:, None], atol=1e-12
    )


@pytest.mark.parametrize(("rows", "least"), [("standard", 0.5), ("eq18", 0.0)])
def test_errors_are_as_large_as_their_deviations(
    servicer, skewed_target, zero_momentum_motion, rows, least
):
    """Root mean square of error over σ, for each parameter, over logs with white noise."""
    truth, ratios = skewed_target.to_vector(), []
    identifier = MomentumIdentifier(servicer, rows=rows)
    for seed in range(30):
        states = servicer.to_states(zero_momentum_motion(skewed_target, 20, seed=47))
        rng = np.random.default_rng(seed)
        context = identifier.CreateDefaultContext()
        for state in states + 1e-5 * rng.normal(size=states.shape):
            take(identifier, context, state)
        found = identifier.identification(context)
        ratios.append((found.parameters - truth) / np.sqrt(np.diag(found.covariance)))
    size = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert (size > least).all()
    assert (size < 2.0).all()


def test_inconsistent_estimates_leave_consistent(servicer, paper_target, zero_momentum_motion):
    """The paper's target is on the limit: rounded data put the raw estimate beyond it."""
    rough = zero_momentum_motion(paper_target, 10, seed=46).rounded(3)
    identifier = MomentumIdentifier(servicer)
    context = identifier.CreateDefaultContext()
    for state in servicer.to_states(rough):
        take(identifier, context, state)
    assert not identifier.identification(context).raw().is_physically_consistent()
    inertia = identifier.GetOutputPort("spatial_inertia").Eval(context)
    assert inertia.IsPhysicallyValid()
    assert inertia.get_mass() > 0


def test_one_identifier_serves_many_contexts(servicer, motion, skewed_target):
    """Everything is in the Context: interleaved runs and clones do not disturb each other."""
    identifier = MomentumIdentifier(servicer)
    states = servicer.to_states(motion)
    one, other = identifier.CreateDefaultContext(), identifier.CreateDefaultContext()
    for state in states[:5]:
        take(identifier, one, state)
    paused = one.Clone()
    take(identifier, other, states[7])
    for state in states[5:]:
        take(identifier, one, state)
    for state in states[5:]:
        take(identifier, paused, state)
    np.testing.assert_array_equal(
        outputs(identifier, one)["parameters"], outputs(identifier, paused)["parameters"]
    )
    assert outputs(identifier, other)["diagnostics"][0] == 1


@pytest.mark.parametrize(
    ("period", "offset", "count"), [(1.0, 1.0, 4), (0.5, 0.25, 8), (2, 0, 3), (0.1, 0.2, 39)]
)
def test_samples_are_taken_at_the_given_times(servicer, motion, period, offset, count):
    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantVectorSource(servicer.to_states(motion)[0]))
    identifier = MomentumIdentifier.AddToBuilder(
        builder, servicer, state=source.get_output_port(), period=period, offset=offset
    )
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(4.0)
    root_context = simulator.get_mutable_context()
    for _ in range(2):  # the sample that is due at the end is taken once
        assert identifier.Finish(root_context).sample_count == count
    simulator.AdvanceTo(4.0 + 0.1 * period)
    assert identifier.Finish(root_context).sample_count == count


@pytest.mark.parametrize(
    ("ports", "message"),
    [
        (["stat"], "has no input 'stat'"),
        ([], "no output port is given for its input 'state'"),
        (["state", "parameters"], "has no input 'parameters'"),
    ],
)
def test_ports_that_do_not_fit_are_named(servicer, motion, ports, message):
    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantVectorSource(servicer.to_states(motion)[0]))
    given = dict.fromkeys(ports, source.get_output_port())
    with pytest.raises(InputError, match=message):
        MomentumIdentifier(servicer).connected(builder, **given)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ((slice(0, 4), 0.3), "quaternion_WB is not of unit norm"),
        ((20, np.nan), "'w_WB' is not finite"),
        ((slice(19, 25), 1e308), "not finite"),
    ],
)
def test_states_that_mean_nothing_are_refused(servicer, motion, change, message):
    state = servicer.to_states(motion)[0]
    state[change[0]] = change[1]
    identifier = MomentumIdentifier(servicer)
    context = identifier.CreateDefaultContext()
    with pytest.raises(InputError, match=message), np.errstate(all="ignore"):
        take(identifier, context, state)
    assert outputs(identifier, context)["diagnostics"][0] == 0


@pytest.mark.parametrize(("rows", "size"), [("standard", 17), ("relative", 14)])
def test_an_unknown_momentum_is_estimated_along(servicer, skewed_target, rows, size):
    """Online as in batch: its unknowns lead the triangle, and the rest is the target's problem."""
    rng = np.random.default_rng(43)
    arms = HalfCosine(rng.uniform(-1, 1, 12), rng.uniform(-1, 1, 12), duration=10.0)
    momentum_W = np.array([2.0, -3.0, 1.0, 0.5, 0.8, -0.6])
    telemetry = true_telemetry(
        servicer.tree,
        servicer.joint_names,
        arms,
        skewed_target,
        np.linspace(0.5, 9.5, 8),
        momentum_W,
    )
    identifier = MomentumIdentifier(servicer, rows=rows, momentum=TotalMomentum.unknown())
    context = identifier.CreateDefaultContext()
    assert context.get_discrete_state(0).size() == size**2
    for state in servicer.to_states(telemetry):
        take(identifier, context, state)
    found = outputs(identifier, context)["parameters"]
    np.testing.assert_allclose(found, skewed_target.to_vector(), rtol=0, atol=1e-7)
    batch = identify(servicer, telemetry, rows=rows, momentum=TotalMomentum.unknown())
    np.testing.assert_allclose(found, batch.parameters, rtol=1e-9, atol=1e-10)


# -- the checks ----------------------------------------------------------------------------------


def verdicts(servicer, states, rows) -> tuple[list[bool], tuple[str, ...]]:
    """Return the port after each sample, and the sentences of what failed after the last one."""
    identifier = MomentumIdentifier(servicer, rows=rows)
    context, passed = identifier.CreateDefaultContext(), []
    assert identifier.GetOutputPort("checks_passed").Eval(context)[0] == 0.0
    for state in states:
        take(identifier, context, state)
        passed.append(identifier.GetOutputPort("checks_passed").Eval(context)[0] == 1.0)
    return passed, identifier.identification(context).failures


@pytest.fixture(scope="module")
def measured(servicer, skewed_target):
    """Return a function (momentum_W) -> the exact motion of a transfer, in forty samples."""
    rng = np.random.default_rng(43)
    arms = HalfCosine(rng.uniform(-1, 1, 12), rng.uniform(-1, 1, 12), duration=10.0)
    times = np.linspace(0.25, 9.9, 40)

    def make(momentum_W=None):
        given = np.zeros(6) if momentum_W is None else momentum_W
        return true_telemetry(
            servicer.tree, servicer.joint_names, arms, skewed_target, times, given
        )

    return make


@pytest.mark.parametrize("rows", ["eq18", "standard"])
@pytest.mark.parametrize("digits", [None, 8])
def test_checks_pass_where_all_is_as_assumed(servicer, measured, rows, digits):
    """With exact samples, and with samples that are rounded to what integration leaves."""
    motion = measured() if digits is None else measured().rounded(digits)
    passed, failures = verdicts(servicer, servicer.to_states(motion), rows)
    assert failures == ()
    assert passed == 3 * [False] + 37 * [True]  # three samples leave few residuals


@pytest.mark.parametrize("rows", ["eq18", "standard"])
@pytest.mark.parametrize("wrong", ["momentum", "gyro", "noise"])
def test_a_wrong_assumption_fails_a_check(servicer, measured, rows, wrong):
    """Four samples contradict a momentum, a bias of the gyro, and noise inside of the rows."""
    motion = measured([1.0, -2.0, 1.0, 2.0, -3.0, 1.0] if wrong == "momentum" else None)
    if wrong == "gyro":
        motion = replace(motion, w_WB=motion.w_WB + 3e-4)
    if wrong == "noise":
        motion = motion.rounded(5)
    passed, failures = verdicts(servicer, servicer.to_states(motion), rows)
    assert not any(passed)
    assert "is not conserved" in "; ".join(failures)


def test_a_target_that_changes_fails_a_check(
    servicer, paper_target, skewed_target, zero_momentum_motion
):
    """As where it sheds a part: each half alone has a rigid body."""
    both = [
        servicer.to_states(zero_momentum_motion(target, 16, seed))
        for target, seed in ((skewed_target, 1), (paper_target, 2))
    ]
    assert verdicts(servicer, both[1], "standard")[0][-1]
    passed, failures = verdicts(servicer, np.concatenate(both), "standard")
    assert passed[15]
    assert not passed[-1]
    assert "the first half of the samples has another target" in "; ".join(failures)
