"""The simulated hardware logs are what they claim: momentum as in Drake, impulses, noise."""

import numpy as np
import pytest
from hardware import Body, Craft, Joint, Valve, run, sines
from hardware_draws import KINDS, floor, identified, pushed, valves
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RotationalInertia, SpatialInertia
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc

X, Y, Z = np.eye(3)


def arm(rng: np.random.Generator) -> Craft:
    """A base with a turning and a sliding joint, neither of them along the other."""
    joints = [
        Joint("turn", "revolute", Z, np.array([0.2, 0.1, 0.0]), Body.drawn(rng, 1.5, 0.2, 0.1 * X)),
        Joint(
            "slide", "prismatic", Y, np.array([0.3, 0.0, 0.1]), Body.drawn(rng, 0.8, 0.1, 0.1 * Z)
        ),
        Joint("tilt", "revolute", X, np.array([0.0, 0.2, 0.0])),
    ]
    base, target = Body.drawn(rng, 9.0, 0.4, 0.02 * X), Body.drawn(rng, 6.0, 0.3, [0.1, 0.05, 0.02])
    return Craft(base, target, joints, np.array([0.1, 0.0, 0.0]))


def test_momentum_is_that_of_drake():
    """Drake sums the momenta of all bodies of the URDF, whose joints move as the oracle's."""
    rng = np.random.default_rng(0)
    craft, times = arm(rng), np.arange(101) / 20
    motion = sines(rng, np.array([0.8, 0.1, 0.6]), 0.1, 0.3)
    h = np.array([0.3, -0.2, 0.1, 0.5, 0.4, -0.3])
    found = run(craft, times, motion, rng, momentum=h)
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(craft.urdf(), "urdf")
    m, c, moments = np.split(craft.target.parameters(), [1, 4])
    inertia = SpatialInertia.MakeFromCentralInertia(m[0], c, RotationalInertia(*moments))
    instance = plant.AddModelInstance("target")
    target = plant.AddRigidBody("target", instance, inertia)
    plant.WeldFrames(plant.GetFrameByName("capture_point"), target.body_frame())
    plant.Finalize()
    context, (q, qdot) = plant.CreateDefaultContext(), motion(times)
    for k in (0, 37, 100):
        R = Rotation.from_quat(found["quat"][k], scalar_first=True)
        V = [*R.apply(found["w_B"][k]), *R.apply(found["v_B"][k])]
        plant.SetPositions(context, [*found["quat"][k], *found["p"][k], *q[k]])
        plant.SetVelocities(context, [*V, *qdot[k]])
        total = plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3)).get_coeffs()
        np.testing.assert_allclose(total, h, atol=1e-9)
    middle = slice(2, None), slice(1, -1), slice(None, -2)
    step = (found["p"][middle[0]] - found["p"][middle[2]]) * 10
    R = Rotation.from_quat(found["quat"], scalar_first=True)
    np.testing.assert_allclose(step, R.apply(found["v_B"])[middle[1]], atol=2e-3)


@pytest.mark.parametrize("on", ["body", "target"])
@pytest.mark.parametrize("axes", ["body", "world"])
def test_impulses_move_the_centre_of_mass_and_come_late(on, axes):
    """A pulse of 1 s of two valves: late, less by the loss, along the axes that they name."""
    rng = np.random.default_rng(1)
    craft, times = arm(rng), np.arange(61) / 20
    valves = [Valve(0.2 * Y, X, 0.7, 0.9, on, axes), Valve(0.1 * Z, -Y, 0.4, 1.0, on, axes)]
    valves.append(Valve(0.1 * X, X, 0.5, 0.0))  # dead

    def command(row, now):
        return np.ones(3) * (10 <= row < 30)

    angle = np.array([[0.5, 0.1, 0.0]])

    def rest(t):
        return np.repeat(angle, len(t), axis=0), np.zeros((len(t), 3))

    found = run(craft, times, rest, rng, valves=valves, command=command, delay=0.13, loss=0.05)
    assert not found["P"][12].any()
    assert found["P"][13].any()
    np.testing.assert_allclose(found["P"][33:], found["P"][[33]].repeat(28, axis=0), atol=1e-14)
    turned = (
        Rotation.from_euler("z", 0.5) if on == "target" and axes == "body" else Rotation.identity()
    )
    impulse = turned.apply(0.9 * (0.63 * X - 0.4 * Y))
    size = np.linalg.norm(found["P"][-1])
    assert size <= np.linalg.norm(impulse) * (1 + 1e-9)
    if axes == "world":  # else the base turns while they push
        np.testing.assert_allclose(found["P"][-1], impulse, rtol=1e-9)
    else:
        np.testing.assert_allclose(found["P"][-1], impulse, atol=0.1)
    M, _, R_BC, p_BC = craft.at(*rest(times[:1]))
    com = np.array([M[0, 2, 4], M[0, 0, 5], M[0, 1, 3]]) / M[0, 5, 5]
    at = found["p"] + Rotation.from_quat(found["quat"], scalar_first=True).apply(com)
    np.testing.assert_allclose((at[-1] - at[-11]) * 2 * M[0, 5, 5], found["P"][-1], atol=1e-6)
    spin = found["L"][-1] - np.cross(at[-1], found["P"][-1])
    arms = [p_BC[0] + R_BC[0] @ v.position if on == "target" else v.position for v in valves[:2]]
    push = [turned.apply(0.95 * v.force * v.share * v.direction) for v in valves[:2]]
    torque = sum(np.cross(a - com, f) for a, f in zip(arms, push))
    np.testing.assert_allclose(spin, torque * 1.0, atol=0.03)


def test_the_floor_is_white():
    """Momentum changes by the declared amount times the root of the time, each axis alike."""
    rng = np.random.default_rng(2)
    craft, times = arm(rng), np.arange(2001) / 5

    def rest(t):
        return np.zeros((len(t), 3)), np.zeros((len(t), 3))

    found = run(craft, times, rest, rng, floor=(2e-3, 0.0))
    for step in (1, 10):
        change = np.diff(found["P"][::step], axis=0) / 17.3 / np.sqrt(step / 5)
        np.testing.assert_allclose(change.std(axis=0), 2e-3, rtol=3 / np.sqrt(2 * len(change)))


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_draws_the_same_files(kind, tmp_path):
    first, second = (KINDS[kind](3, tmp_path / name) for name in "ab")
    with np.load(first.logs[0]) as a, np.load(second.logs[0]) as b:
        assert a.files == b.files
        for name in a.files:
            np.testing.assert_array_equal(a[name], b[name])
    assert first.sensors.read_text() == second.sensors.read_text()


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "declared"), [(1, True), (2, False), (4, True), (5, False)])
def test_a_platform_that_only_valves_move_is_identified(tmp_path, seed, declared):
    """In space or on a floor; one valve dead, thrust late, and nothing else changes momentum.

    Whether or not the sensors' file declares that forces err. If it does not, its forces are
    assumed to err so much that the mass need not be known.
    """
    found = identified(valves(seed, tmp_path, declared=declared), "--momentum", "unknown")
    assert found["code"] in (0, 3)
    assert found["named"]
    assert not found["changes"]
    assert found["known"] >= 3 or (found["code"] == 3 and not declared)
    assert not found["worst"] >= 3


@pytest.mark.slow
def test_weakly_known_inertia_does_not_move_the_rest(tmp_path):
    """The samples know the inertia to 70 % of a size, and more than 3 σ from where it is held."""
    known = "--momentum", "unknown", "--known-bodies", "exact"
    found = identified(pushed(11, tmp_path), *known)
    assert found["code"] in (0, 3)
    assert chdtrc(found["known"], found["nees"]) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("logs", [1, 3])
def test_an_arm_on_a_noisy_floor_is_seen_well_enough_at_5_Hz(tmp_path, logs):
    """With gaps, noise of three times the declared one, and zeros of the joints that are off."""
    found = identified(floor(6, tmp_path, logs=logs), "--momentum", "unknown")
    assert found["code"] == 0
    assert found["known"] == 4
    assert found["worst"] < 3


@pytest.mark.slow
def test_who_moves_the_base_by_hand_fails_a_check(tmp_path):
    """By 0.3 m within a second: the momentum changes by more than the floor can change it."""
    found = identified(floor(5, tmp_path, step=0.3), "--momentum", "unknown")
    assert found["code"] == 4
    failed = [line for line in found["text"].splitlines() if line.startswith("failed check")]
    assert any("changes of the momentum" in line for line in failed)
