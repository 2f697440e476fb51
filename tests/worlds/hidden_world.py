"""Logs with one hidden error each, of two crafts in MuJoCo: no code is shared with the package.

The package gets the file `Craft.mjcf` and samples; truth, physics and noise are made here. Torques
follow the motion without steps: a gain that changes with the samples leaves 3e-6 rad/s in each of
them, which the best gyros see.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake import SensorSuite
from cpid_drake.logs.log import Log, Samples
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro, JointSensor, VectorSensor

Array = NDArray[np.float64]
SENSORS = ("attitude", "gyro", "position", "encoders")
ARCSEC = np.pi / 180 / 3600
RAMP = 3.0
"""Seconds in which the motion rises from rest."""

FOLLOW, DAMP = 100.0, 20.0
"""Stiffness and damping of the servos of rigid joints, over the inertia [1/s², 1/s]."""

ORBIT_RATE = 1.13e-3
"""Of a low orbit [rad/s]."""

TAUS = np.array([0.1, 0.3, 1.0, 3.0, 10.0])
"""Correlation times whose sum is flicker noise [s]."""


@dataclass(frozen=True)
class Craft:
    """A spacecraft with one arm; its links are along x, and its numbers are exact in the file.

    Attributes:
        base: mass [kg], radii of gyration [m] and centre of mass [m].
        links: of each joint's link: axis, mass [kg] and length [m].
        mount: where the arm begins [m].
        centre: pose about which the arm moves [rad].
        target: mass [kg], radii of gyration [m] and centre of mass [m].
        rates: of attitude, gyro, position and encoders [Hz].
        sigmas: of a sample of these; attitude across and around the boresight, z.
        strong: how much larger than on the small craft a leak is.
        wheel: hidden angular momentum [N·m·s].

    """

    base: tuple[float, tuple[float, float, float], tuple[float, float, float]]
    links: tuple[tuple[str, float, float], ...]
    mount: tuple[float, float, float]
    centre: tuple[float, ...]
    target: tuple[float, tuple[float, float, float], tuple[float, float, float]]
    rates: tuple[float, float, float, float]
    sigmas: tuple[float, float, float, float, float]
    strong: float
    wheel: float

    def mjcf(self) -> str:
        """Return the model file that the user has; the frame of the grasp is the body `grip`."""
        mass, radii, com = self.base
        arm = f'<body name="grip" pos="{self.links[-1][2]} 0 0"/>'
        for k in reversed(range(len(self.links))):
            axis, m, length = self.links[k]
            at = "{} {} {}".format(*self.mount) if k == 0 else f"{self.links[k - 1][2]} 0 0"
            slim, long = m * length**2 * 0.03, m * length**2 * 0.1
            arm = (
                f'<body name="link{k + 1}" pos="{at}"><inertial pos="{length / 2} 0.004 0.002" '
                f'mass="{m}" diaginertia="{slim:.9f} {long:.9f} {long:.9f}"/>'
                f'<joint name="joint{k + 1}" axis="{axis}"/>{arm}</body>'
            )
        inertia = " ".join(f"{mass * radius**2:.9f}" for radius in radii)
        return (
            '<mujoco model="craft"><worldbody><body name="base"><freejoint name="free"/><inertial '
            f'pos="{com[0]} {com[1]} {com[2]}" mass="{mass}" diaginertia="{inertia}"/>'
            f"{arm}</body></worldbody></mujoco>"
        )

    def suite(self) -> SensorSuite:
        """Return the sensors as the user declares them: their noise only."""
        cross, boresight, gyro, position, encoders = self.sigmas
        return SensorSuite(
            "white noise",
            AttitudeSensor(self.rates[0], cross / ARCSEC, boresight / ARCSEC),
            Gyro(self.rates[1], np.degrees(gyro) * 60 / np.sqrt(self.rates[1])),
            VectorSensor(self.rates[2], position),
            encoders=JointSensor(self.rates[3], encoders),
        )


X, Y, Z = "1 0 0", "0 1 0", "0 0 1"
CRAFTS = {
    "free_flyer": Craft(
        base=(9.0, (0.126, 0.122, 0.132), (0.004, -0.003, 0.006)),
        links=((X, 0.5, 0.06), (Y, 0.6, 0.2), (Y, 0.5, 0.18), (Z, 0.3, 0.06), (X, 0.4, 0.1)),
        mount=(0.16, 0.0, 0.03),
        centre=(0.4, -0.5, 1.1, 0.3, -0.2),
        target=(8.5, (0.13, 0.16, 0.15), (0.2, 0.03, -0.02)),
        rates=(50.0, 50.0, 50.0, 50.0),
        sigmas=(180 * ARCSEC, 180 * ARCSEC, np.radians(0.1) / 60 * np.sqrt(50), 5e-4, 1e-4),
        strong=1.0,
        wheel=0.005,
    ),
    "servicer": Craft(
        base=(175.0, (0.42, 0.4, 0.45), (0.02, -0.01, 0.03)),
        links=(
            *((Z, 5.0, 0.15), (Y, 7.0, 0.8), (Y, 6.0, 0.7), (X, 3.0, 0.2)),
            *((Y, 3.0, 0.2), (X, 2.0, 0.2)),
        ),
        mount=(0.5, 0.1, 0.1),
        centre=(0.3, -0.8, 1.3, 0.4, 0.7, -0.2),
        target=(60.0, (0.35, 0.4, 0.3), (0.4, 0.06, -0.05)),
        rates=(4.0, 100.0, 10.0, 100.0),
        sigmas=(2 * ARCSEC, 20 * ARCSEC, np.radians(1e-3) / 60 * 10, 1e-3, 2e-6),
        strong=10.0,
        wheel=0.5,
    ),
}

# -- what is hidden -------------------------------------------------------------------------------


Noise = Callable[[np.random.Generator, tuple[int, int], float], Array]
"""Makes noise (N, n) of unit variance of a sensor with a rate [Hz]."""


def white(rng: np.random.Generator, shape: tuple[int, int], rate: float) -> Array:
    """Return white noise."""
    return rng.standard_normal(shape)


def correlated(rng: np.random.Generator, shape: tuple[int, int], rho: float) -> Array:
    """Return noise (N, n) of unit variance with a correlation of neighbours."""
    found, fresh = np.empty(shape), np.sqrt(1 - rho**2) * rng.standard_normal(shape)
    found[0] = rng.standard_normal(shape[1])
    for k in range(1, shape[0]):
        found[k] = rho * found[k - 1] + fresh[k]
    return found


def half(rng: np.random.Generator, shape: tuple[int, int], rhos: Sequence[float]) -> Array:
    """Return noise of which half of the variance is white, the rest evenly correlated."""
    slow = sum(correlated(rng, shape, rho) for rho in rhos) / np.sqrt(len(rhos))
    return np.sqrt(0.5) * (rng.standard_normal(shape) + slow)


@dataclass(frozen=True)
class Hidden:
    """One hidden error; zero is none.

    Attributes:
        leak: force fixed in the base [N], of the small craft.
        grasp, joints: stiffness of the grasp about each axis, and of each joint [N·m/rad].
        slosh: share of the base's mass that moves on a spring of 0.7 Hz.
        gyro: σ of the scale of each axis; its axes are misaligned by as much.
        zeros: σ of the joints' zeros [rad].
        late: of attitude and position [s].
        noise: of all sensors.
        clock: by which the gyro's clock is fast.
        wheel: whether a rotor spins in the base.
        gradient: whether the craft is in an orbit.
        base: share by which mass and inertia of the base are larger.
        arm: σ of places [m] and axes [rad] of the joints.
        wheels: σ of the momentum of wheels in the base, about each axis [N·m·s], and
        torque: σ of a torque on the base [N·m], of the small craft; both change smoothly.
        spin: momentum of a rotor in the target [N·m·s], of the small craft.
        scale: σ of the scale of each encoder, and
        turn: size of its error once a turn [rad].

    """

    leak: float = 0.0
    grasp: float = 0.0
    joints: float = 0.0
    slosh: float = 0.0
    gyro: float = 0.0
    zeros: float = 0.0
    late: float = 0.0
    noise: Noise = white
    clock: float = 0.0
    wheel: bool = False
    gradient: bool = False
    base: float = 0.0
    arm: float = 0.0
    wheels: float = 0.0
    torque: float = 0.0
    spin: float = 0.0
    scale: float = 0.0
    turn: float = 0.0


KINDS: dict[str, Hidden] = {
    "none": Hidden(),
    "leak0.3": Hidden(leak=3e-4),
    "leak2": Hidden(leak=2e-3),
    "leak5": Hidden(leak=5e-3),
    "grasp1e3": Hidden(grasp=1e3),
    "grasp1e4": Hidden(grasp=1e4),
    "grasp1e5": Hidden(grasp=1e5),
    "joints2e3": Hidden(joints=2e3),
    "joints2e4": Hidden(joints=2e4),
    "slosh": Hidden(slosh=0.02),
    "gyro": Hidden(gyro=1e-3),
    "zeros": Hidden(zeros=2e-3),
    "late": Hidden(late=0.02),
    "rho0.5": Hidden(noise=lambda rng, shape, rate: correlated(rng, shape, 0.5)),
    "rho0.9": Hidden(noise=lambda rng, shape, rate: correlated(rng, shape, 0.9)),
    "half": Hidden(noise=lambda rng, shape, rate: half(rng, shape, [0.9])),
    "flicker": Hidden(noise=lambda rng, shape, rate: half(rng, shape, np.exp(-1 / rate / TAUS))),
    "clock": Hidden(clock=5e-5),
    "wheel": Hidden(wheel=True),
    "gradient": Hidden(gradient=True),
    "base": Hidden(base=0.01),
    "arm": Hidden(arm=5e-4),
    "wheels": Hidden(wheels=1e-3),
    "torque": Hidden(torque=1e-3),
    "swing": Hidden(slosh=0.005),
    "spin": Hidden(spin=5e-3),
    "scale": Hidden(scale=3e-3),
    "turn": Hidden(turn=5e-3),
}

# -- the simulator --------------------------------------------------------------------------------


class World:
    """A craft with its hidden error in MuJoCo.

    Attributes:
        craft, hidden: see there.
        model, data: MuJoCo's.
        truth: (10,) inertial parameters of the target in the frame of the grasp.

    """

    def __init__(self, craft: Craft, hidden: Hidden, rng: np.random.Generator) -> None:
        self.craft, self.hidden = craft, hidden
        spec = mujoco.MjSpec.from_string(craft.mjcf())
        self.truth = self._hold(spec.body("grip").add_body(name="target"), rng)
        base, size = spec.body("base"), craft.base[1][0]
        mass, com = craft.base[0], np.array(craft.base[2])
        J = np.diag(mass * np.square(craft.base[1]))  # about the centre of mass
        moving, at = 0.0, com + size * np.array([0.6, -0.4, 0.5])
        if hidden.slosh or hidden.wheel:  # the file has it fixed in the base
            moving = mass * (hidden.slosh or 0.01)
            own, part = moving * (0.1 * size) ** 2, base.add_body(name="part", pos=at)
            part.mass, part.inertia, part.ipos = moving, np.full(3, own), np.zeros(3)
            part.explicitinertial = True
            for axis in np.eye(3) if hidden.slosh else []:
                spring = {"stiffness": moving * (2 * np.pi * 0.7) ** 2, "damping": 0.3 * moving}
                part.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, **spring)
            if hidden.wheel:
                part.add_joint(name="rotor", axis=[0.36, 0.48, 0.8])
            left = (mass * com - moving * at) / (mass - moving)
            for m, d in ((mass - moving, left - com), (moving, at - com)):  # Steiner
                J = J - m * (d @ d * np.eye(3) - np.outer(d, d))
            J, com, mass = J - own * np.eye(3), left, mass - moving
        base.mass, base.ipos, base.inertia = mass * (1 + hidden.base), com, np.zeros(3)
        base.fullinertia = (1 + hidden.base) * J[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        option = spec.option
        option.integrator, option.gravity = mujoco.mjtIntegrator.mjINT_RK4, np.zeros(3)
        option.timestep = 2e-4 if hidden.joints else 5e-4 if hidden.grasp else 2e-3
        for joint in spec.joints:  # rotors turn with the motors, and have no momentum in a base
            if joint.name.startswith("joint"):
                joint.armature = 0.02 * craft.target[0] * size * (0.1 if hidden.joints else 1)
        drawn = rng.spawn(1)[0]  # the motion stays the same
        for k in range(len(craft.links)):
            body, joint = spec.body(f"link{k + 1}"), spec.joint(f"joint{k + 1}")
            body.pos = body.pos + hidden.arm * drawn.standard_normal(3)
            joint.axis = joint.axis + hidden.arm * drawn.standard_normal(3)
        option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.model = spec.compile()
        self.data, self.base = mujoco.MjData(self.model), self.model.body("base").id
        names = [f"joint{k + 1}" for k in range(len(craft.links))]
        self.at = np.array([self.model.joint(name).dofadr[0] for name in names])
        self.data.qpos[self.at + 1] = craft.centre
        if hidden.wheel:
            rotor = self.model.joint("rotor").dofadr[0]
            self.data.qvel[rotor] = craft.wheel / own
        count = len(names)
        self.swing = rng.uniform(0.15, 0.3, (2, count))
        self.w = 2 * np.pi * rng.uniform([[0.08]] * 2, [[0.25], [0.35]], (2, count))
        self.phase = rng.uniform(-np.pi, np.pi, (2, count))
        direction = rng.standard_normal(3)
        self.force_B = hidden.leak * craft.strong * direction / np.linalg.norm(direction)
        self.point_B = size * rng.uniform(-1, 1, 3)
        self.target = self.model.body("target").id
        self.spin_T = hidden.spin * craft.strong * np.array([0.48, 0.6, 0.64])
        self.changing = drawn.standard_normal((2, 4, 3)) / 2  # of four frequencies
        self.frequencies = 2 * np.pi * np.array([0.07, 0.17, 0.31, 0.53])

    def _hold(self, body: "mujoco.MjsBody", rng: np.random.Generator) -> Array:
        """Give the target's body its inertia, turned at random; return its parameters (10,)."""
        mass, radii, com = self.craft.target
        R, c = Rotation.random(rng=rng).as_matrix(), np.array(com) * rng.uniform(0.7, 1.3, 3)
        J = R @ np.diag(mass * np.square(radii)) @ R.T
        body.mass, body.ipos, body.explicitinertial = mass, c, True
        body.fullinertia = J[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        if stiffness := self.hidden.grasp:
            damping = 0.1 * np.sqrt(stiffness * np.trace(J) / 3)
            for axis in np.eye(3):
                body.add_joint(axis=axis, stiffness=stiffness, damping=damping)
        return np.array([mass, *c, *J[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]])

    def reference(self, t: float) -> tuple[Array, Array]:
        """Return where the joints are to be, and how fast."""
        x = min(t / RAMP, 1.0)
        r, dr = x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3), 140 * (x * (1 - x)) ** 3 / RAMP
        s, c = np.sin(self.w * t + self.phase), np.cos(self.w * t + self.phase)
        q = self.craft.centre + r * (self.swing * s).sum(0)
        return q, (self.swing * (dr * s + r * self.w * c)).sum(0)

    def _act(self, model: "mujoco.MjModel", data: "mujoco.MjData") -> None:
        """Apply what acts now: MuJoCo asks in each stage of a step, so nothing is sampled."""
        at, hidden = self.at, self.hidden
        wanted, rate = self.reference(data.time)
        error, rate_error = wanted - data.qpos[at + 1], rate - data.qvel[at]
        if hidden.joints:  # the encoder is on the motor, the spring behind it
            data.qfrc_applied[at] = hidden.joints * (error + 1e-3 * rate_error)
        else:
            data.qfrc_applied[at] = self.inertia @ (FOLLOW * error + DAMP * rate_error)
        if hidden.leak:
            R = data.xmat[self.base].reshape(3, 3)
            arm_B = self.point_B - model.body_ipos[self.base]
            torque_B = np.cross(arm_B, self.force_B)
            data.xfrc_applied[self.base] = [*R @ self.force_B, *R @ torque_B]
        if hidden.torque or hidden.wheels:
            R, wt = data.xmat[self.base].reshape(3, 3), self.frequencies * data.time
            x = np.cos(wt) @ self.changing[0] + np.sin(wt) @ self.changing[1]
            rate = self.frequencies * np.stack([-np.sin(wt), np.cos(wt)])
            change = np.einsum("kf,kfi->i", rate, self.changing)
            torque_B = hidden.torque * x - hidden.wheels * change
            torque_B -= np.cross(data.qvel[3:6], hidden.wheels * x)  # their momentum turns with B
            data.xfrc_applied[self.base, 3:] = self.craft.strong * R @ torque_B
        if hidden.spin:
            R, V = data.xmat[self.target].reshape(3, 3), np.empty(6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, self.target, V, 1)
            data.xfrc_applied[self.target, 3:] = R @ np.cross(self.spin_T, V[:3])
        if hidden.gradient:
            n, r = np.array([0.6, 0.0, 0.8]), data.xipos
            R = data.ximat.reshape(-1, 3, 3)
            I_n = np.einsum("bij,bj,bkj,k->bi", R, model.body_inertia, R, n)
            pull = model.body_mass[:, None] * (3 * np.outer(r @ n, n) - r)
            data.xfrc_applied[:] = ORBIT_RATE**2 * np.hstack([pull, 3 * np.cross(n, I_n)])

    def run(self, duration: float) -> tuple[Array, Array]:
        """Return times (N,) 10 ms apart, and attitude, position, rates and joints (N, 10 + J)."""
        model, data = self.model, self.data
        every = round(0.01 / model.opt.timestep)
        rows, times = [], np.arange(round(duration / 0.01) + 1) * 0.01
        mujoco.mj_forward(model, data)
        M, servo = np.empty((model.nv, model.nv)), np.concatenate([np.arange(6), self.at])
        for row, unit in zip(M, np.eye(len(M))):
            mujoco.mj_mulM(model, data, row, unit)
        free = np.linalg.inv(M[np.ix_(servo, servo)])[6:, 6:]
        self.inertia = np.linalg.inv(free)  # of the joints, if the base is free
        mujoco.set_mjcb_control(self._act)
        try:
            for time in times:
                seen = self.reference(time)[0] if self.hidden.joints else data.qpos[self.at + 1]
                rows.append(np.concatenate([data.qpos[3:7], data.qpos[:3], data.qvel[3:6], seen]))
                mujoco.mj_step(model, data, every)
        finally:
            mujoco.set_mjcb_control(None)
        return times, np.array(rows)


def simulate(craft: Craft, hidden: Hidden, seed: int) -> tuple[Log, Array]:
    """Return the log of a seed, and the target's true parameters."""
    rng = np.random.default_rng([18, seed])  # all kinds have the same motions and targets
    duration = rng.uniform(10, 20)
    world = World(craft, hidden, rng)
    times, rows = world.run(duration)
    true = dict(zip(("attitude", "position", "gyro", "encoders"), np.split(rows, [4, 7, 10], 1)))
    true["gyro"] = true["gyro"] @ (np.eye(3) + hidden.gyro * rng.standard_normal((3, 3)))
    true["encoders"] = true["encoders"] + hidden.zeros * rng.standard_normal(len(craft.links))
    drawn = rng.spawn(1)[0]
    scale, phase = drawn.standard_normal(len(craft.links)), drawn.uniform(0, 6, len(craft.links))
    turn = hidden.turn * np.sin(true["encoders"] + phase)
    true["encoders"] = true["encoders"] * (1 + hidden.scale * scale) + turn
    *across, gyro, position, encoders = craft.sigmas
    sigmas = (np.array([across[0], *across]), gyro, position, encoders)
    samples = {}
    for name, rate, sigma in zip(SENSORS, craft.rates, sigmas):
        step = round(100 / rate)
        stamps, values = times[::step], true[name][::step]
        shape = (len(stamps), 3 if name == "attitude" else values.shape[1])
        unit = hidden.noise(rng, shape, rate)
        noise = sigma * unit
        if name == "attitude":
            turned = Rotation.from_quat(values, scalar_first=True) * Rotation.from_rotvec(noise)
            values = turned.as_quat(canonical=False, scalar_first=True)
        else:
            values = values + noise
        late = hidden.late if name in ("attitude", "position") else 0.0
        fast = 1 + hidden.clock * (name == "gyro")
        samples[name] = Samples(stamps * fast + late, values)
    return Log(tuple(f"joint{k + 1}" for k in range(len(craft.links))), samples), world.truth
