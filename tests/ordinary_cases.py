"""What the logs of ordinary motions are of: crafts, motions, sensors, and a square of all these.

A number determines its log: the 30 pairs of a craft and a motion come eight times, with other
sensors, lengths, rates and targets, as in a Latin square. Any thirty logs in a row have all pairs,
and are spread over all else.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cpid_drake import InertialParameters, SensorSuite, Spacecraft, TotalMomentum, load_sensors
from cpid_drake.logs.log import Log
from cpid_drake.simulation.trials import Case, draw

Array = NDArray[np.float64]
COUNT, STRIDE = 240, 53
SPEED = 0.7
"""Share of the limits of the joints' rates that a motion reaches at most."""

SLOW = 0.1
"""Share of these limits that a slow motion reaches."""


@dataclass(frozen=True)
class Craft:
    """A shipped spacecraft, a pose in which its arm is bent, and sensors that suit its size.

    Attributes:
        model, base, capture: of `Spacecraft`.
        arm: how the names of the joints of the arm that holds the target begin.
        poses: of the arm's joints [rad], and of other arms by the beginning of their names.
        sensors: names of shipped suites.
        on_table: whether a table carries it.

    """

    model: str
    base: str
    capture: str
    arm: str
    poses: Mapping[str, tuple[float, ...]]
    sensors: tuple[str, ...] = ("flight", "servicer", "coarse", "testbed", "orbit")
    on_table: bool = False

    @cached_property
    def spacecraft(self) -> Spacecraft:
        """The known spacecraft."""
        path = f"package://cpid_drake_models/{self.model}"
        made = Spacecraft(path, base=self.base, capture_frame=self.capture)
        return made.on_table() if self.on_table else made


_DUAL = {
    "capture_arm": (-0.4, -0.4, 1.0, 0.5, 1.2, -0.2),
    "operating_arm": (-0.7, -1.0, 0.9, -1.1, -0.5, 0.6),
}
_SINGLE = {"arm": (-0.1, -0.86, 0.36, 1.25, 0.07, 1.1, 0.25)}
_FREE = ("flight", "servicer", "coarse", "testbed")
CRAFTS = {
    "dual_arm": Craft(
        "dual_arm_servicer/dual_arm_servicer.urdf", "bus", "capture_point", "capture_arm", _DUAL
    ),
    "free_flyer": Craft(
        "free_flyer/free_flyer.urdf",
        "body",
        "capture_point",
        "arm",
        {"arm": (0.8, -0.3, 1.1, -0.1)},
        sensors=(*_FREE, "digits6"),  # the torques of the orbit's file would make it tumble
    ),
    "orbit": Craft(
        "orbit_servicer/orbit_servicer.dmd.yaml", "bus", "capture_point", "arm", _SINGLE
    ),
    "planar": Craft(
        "planar_servicer/planar_servicer.urdf",
        "base",
        "capture_point",
        "arm",
        {"arm": (0.16, 0.24, 0.09)},
        sensors=(*_FREE, "air_bearing"),
        on_table=True,
    ),
    "single_arm": Craft(
        "single_arm_servicer/single_arm_servicer.urdf", "bus", "capture_point", "arm", _SINGLE
    ),
    "other_arm": Craft(
        "dual_arm_servicer/dual_arm_servicer.urdf", "bus", "operating_point", "operating_arm", _DUAL
    ),
}
"""The six; the servicer with two arms can hold the target with either."""

LENGTHS, RATES, TARGETS = (10.0, 60.0), (100.0, 25.0), (0.05, 0.2, 0.7, 2.0)
"""Durations [s], highest rates of samples [Hz] and masses in units of the base's."""


@dataclass(frozen=True, eq=False)
class Legs:
    """Half a cosine of all joints from one pose to another, or cycloids through several poses.

    A motion of several legs has no steps of the acceleration, as no joint with a motor has any.

    Attributes:
        times: (K,) when each pose is reached [s], from 0 on; the last is the duration.
        poses: (K, J) [rad].

    """

    times: Array
    poses: Array

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return float(self.times[-1])

    def evaluate(self, time: ArrayLike) -> Array:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        t = np.clip(np.asarray(time, dtype=float), 0.0, self.duration)
        leg = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2)
        w = (np.pi / np.diff(self.times)[leg])[..., None]
        phase, half = w * (t - self.times[leg])[..., None], np.diff(self.poses, axis=0)[leg] / 2
        if len(self.times) > 2:
            phase, w, turn = 2 * phase, 2 * w, half / np.pi
            q = self.poses[leg] + turn * (phase - np.sin(phase))
            return np.stack(
                [q, turn * w * (1 - np.cos(phase)), turn * w**2 * np.sin(phase)], axis=-2
            )
        q = self.poses[leg] + half * (1 - np.cos(phase))
        return np.stack([q, half * w * np.sin(phase), half * w**2 * np.cos(phase)], axis=-2)

    def instants(self) -> Array:
        """Return times that resolve the motion [s]."""
        return np.linspace(0.0, self.duration, 16 * len(self.times) + 1)

    def breaks(self) -> Array:
        """Return times between which the motion has all derivatives [s]."""
        return self.times


@dataclass(frozen=True, eq=False)
class Arms:
    """The joints that a motion may move.

    Attributes:
        centre: (J,) the pose in the middle; wheels stay at zero [rad].
        rates: (J,) limits [rad/s].
        holding, moving: places of the joints of the arm that holds the target, and of all arms.

    """

    centre: Array
    rates: Array
    holding: Array
    moving: Array

    @classmethod
    def of(cls, craft: Craft) -> "Arms":
        """Return those of a craft."""
        names, limits = craft.spacecraft.joint_names, craft.spacecraft.limits
        centre, moving = np.zeros(len(names)), []
        for arm, pose in craft.poses.items():
            places = [k for k, name in enumerate(names) if name.startswith(f"{arm}_")]
            centre[places] = pose
            moving += places
        holding = [k for k, name in enumerate(names) if name.startswith(f"{craft.arm}_")]
        return cls(centre, limits.rates, np.array(holding), np.array(moving))

    def turn(
        self, rng: np.random.Generator, joints: Array, seconds: float, *, low: float, high: float
    ) -> Array:
        """Return a random turn (J,) of some joints within `seconds`, as fast as limits allow."""
        size, found = rng.uniform(low, high, len(joints)), np.zeros(len(self.centre))
        most = SPEED * self.rates[joints] * 2 * seconds / np.pi
        found[joints] = np.minimum(size, most) * rng.choice([-1.0, 1.0], len(joints))
        return found


def half_cosine(arms: Arms, rng: np.random.Generator, length: float) -> Legs:
    """All joints of all arms, once."""
    turn = arms.turn(rng, arms.moving, length, low=0.5, high=1.2)
    return Legs(np.array([0.0, length]), arms.centre + np.outer([-0.5, 0.5], turn))


def one_by_one(arms: Arms, rng: np.random.Generator, length: float) -> Legs:
    """The joints of the holding arm, one after the other."""
    count, poses = len(arms.holding), [arms.centre]
    for place in rng.permutation(arms.holding):
        turn = arms.turn(rng, np.array([place]), length / count, low=0.4, high=0.9)
        poses.append(poses[-1] + turn)
    return Legs(np.linspace(0.0, length, count + 1), np.array(poses))


def two_joints(arms: Arms, rng: np.random.Generator, length: float) -> Legs:
    """Two joints of the holding arm only."""
    pair = np.sort(rng.choice(arms.holding, 2, replace=False))
    turn = arms.turn(rng, pair, length, low=0.7, high=1.3)
    return Legs(np.array([0.0, length]), arms.centre + np.outer([-0.5, 0.5], turn))


def slow(arms: Arms, rng: np.random.Generator, length: float) -> Legs:
    """All joints to and fro, with a tenth of the limits of their rates."""
    count = round(length / 10)
    size = np.zeros(len(arms.centre))
    size[arms.moving] = SLOW * arms.rates[arms.moving] * 2 * (length / count) / np.pi
    sides = rng.choice([-0.5, 0.5], len(size)) * size
    signs = (-1.0) ** np.arange(count + 1)
    return Legs(np.linspace(0.0, length, count + 1), arms.centre + np.outer(signs, sides))


def pick_and_place(arms: Arms, rng: np.random.Generator, length: float) -> Legs:
    """A rest, lift with two joints, a rest, over to the other side, a rest."""
    pair = arms.holding[:3][-2:]
    lift = arms.turn(rng, pair, 0.25 * length, low=0.3, high=0.5)
    over = arms.turn(rng, arms.holding, 0.4 * length, low=0.5, high=1.0)
    steps = np.array([np.zeros_like(lift), 0 * lift, lift, 0 * lift, over, 0 * over])
    times = length * np.array([0.0, 0.1, 0.35, 0.4, 0.8, 1.0])
    return Legs(times, arms.centre - (lift + over) / 2 + np.cumsum(steps, axis=0))


MOTIONS: dict[str, Callable[[Arms, np.random.Generator, float], Legs]] = {
    "half_cosine": half_cosine,
    "one_by_one": one_by_one,
    "two_joints": two_joints,
    "slow": slow,
    "pick_and_place": pick_and_place,
}


@dataclass(frozen=True)
class Design:
    """What the log of a number is of."""

    number: int

    @property
    def craft(self) -> str:
        """Name of the craft."""
        return list(CRAFTS)[self._place[0] % 6]

    @property
    def motion(self) -> str:
        """Name of the motion."""
        return list(MOTIONS)[self._place[0] % 5]

    @property
    def sensors(self) -> str:
        """Name of the shipped sensors."""
        pair, cell = self._place
        return CRAFTS[self.craft].sensors[(pair // 6 + pair + 2 * cell) % 5]

    @property
    def length(self) -> float:
        """Duration [s]."""
        return LENGTHS[sum(self._place) % 4 // 2]

    @property
    def rate(self) -> float:
        """Highest rate of samples [Hz]."""
        pair, cell = self._place
        return RATES[(pair + cell + pair // 6 + cell // 4) % 2]

    @property
    def share(self) -> float:
        """Mass of the target in units of the base's."""
        pair, cell = self._place
        return TARGETS[(pair // 4 + cell + cell // 4) % 4]

    @property
    def _place(self) -> tuple[int, int]:
        place = STRIDE * self.number % COUNT
        return place % 30, place // 30

    def __str__(self) -> str:
        return (
            f"{self.craft:<10} {self.motion:<14} {self.sensors:<11} {self.length:2.0f} s "
            f"{self.rate:3.0f} Hz {self.share:4.2f}"
        )


@dataclass(frozen=True, eq=False)
class Ordinary:
    """A log, what its user knows, and the truth."""

    design: Design
    spacecraft: Spacecraft
    log: Log
    sensors: SensorSuite
    truth: InertialParameters


def make(design: Design) -> Ordinary:
    """Return the log of a design, by the simulation of campaigns."""
    craft, rng = CRAFTS[design.craft], np.random.default_rng([2016, design.number])
    spacecraft, suite = craft.spacecraft, load_sensors(design.sensors, unstated="exact")
    motion = MOTIONS[design.motion](Arms.of(craft), rng, design.length)
    mass, radius = _base(design.craft)
    truth = _target(rng, mass, radius, design.share)
    momentum = np.zeros(6)
    if design.number // 6 % 2:
        total = spacecraft.mass + truth.mass
        sizes = total * np.repeat([2 * 1e-3 * radius**2, 3e-3], 3)
        momentum = sizes * rng.choice([-1.0, 1.0], 6)
        if craft.on_table:
            momentum[[0, 1, 5]] = 0.0
    case = Case(
        truth=truth,
        motion=motion,
        duration=design.length,
        momentum_W=momentum,
        momentum=TotalMomentum.unknown(),
        known_bodies=None,
        suite=suite,
        seed=2016,
    )
    log = _thinned(draw(case, spacecraft, design.number), suite, design.rate)
    return Ordinary(design, spacecraft, log, suite, truth)


@cache
def _base(name: str) -> tuple[float, float]:
    """Return mass [kg] and radius of gyration [m] of all that is fixed to the base."""
    spacecraft = CRAFTS[name].spacecraft
    plant, context = spacecraft.plant, spacecraft.plant.CreateDefaultContext()
    bodies = [body.index() for body in plant.GetBodiesWeldedTo(spacecraft.base)]
    whole = plant.CalcSpatialInertia(context, spacecraft.base.body_frame(), bodies)
    central = whole.Shift(whole.get_com()).CalcRotationalInertia()
    return whole.get_mass(), float(np.sqrt(central.Trace() / 2 / whole.get_mass()))


def _target(
    rng: np.random.Generator, mass: float, radius: float, share: float
) -> InertialParameters:
    """Return a turned solid box of about the base's density that is held at one of its faces."""
    sides = 2 * radius * np.cbrt(share) * rng.uniform(0.6, 1.1, 3)
    turn = Rotation.from_rotvec(rng.normal(0.0, 0.3, 3)).as_matrix()
    second = share * mass / 12 * turn @ np.diag(sides**2) @ turn.T
    com = np.array([sides[0] / 2, *rng.uniform(-0.15, 0.15, 2) * sides[1:]])
    return InertialParameters(share * mass, com, np.trace(second) * np.eye(3) - second)


def _thinned(log: Log, suite: SensorSuite, rate: float) -> Log:
    """Return a log of which every sensor has samples at most at a rate [Hz]."""
    steps = {name: max(1, round(s.rate / rate)) for name, s in suite.present().items()}
    return log.updated({n: log[n].where(np.arange(len(log[n])) % k == 0) for n, k in steps.items()})
