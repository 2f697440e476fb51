"""Compares a log with the conservation of momentum, to find wrong units, points and conventions.

`logs.consistency` compares positions with rates. The checks here need no rates, but the
spacecraft: they ask which conventions make the base move as its centre of mass allows. The score of
a convention is what its best possible target leaves unexplained, relative to the motion.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.logs.centre_of_mass import (
    BaseTravel,
    TravelFit,
    TravelModel,
    base_travel,
    in_unit,
)
from cpid_drake.logs.consistency import Findings
from cpid_drake.logs.log import Measurements

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254, "ft": 0.3048}
"""Units that positions may be in, by their size in metres; the first is the expected one."""

_UNIT_WORDS = {"mm": "millimetres", "cm": "centimetres", "in": "inches", "ft": "feet"}

_SIGNIFICANT = 50.0
"""Smallest increase of the sum of squared residuals, in units of their variance, that counts."""

_CLEARLY = 2.0
"""Ratio of scores above which another convention explains the motion clearly better."""

_EXPLAINS = 0.7
"""Largest score of a convention that explains the motion."""

_EQUAL = 1.25
"""Ratio of scores up to which a possible target explains a motion as well as an impossible one."""

_FAR = 0.05
"""Distance of a point from B's origin, in reaches of the arm, that model errors do not explain."""

_MOST_WRONG = 10.0
"""Ratio by which no model's masses are wrong; a unit can differ from metres by more."""

_UNDETERMINED = 0.2
"""σ of the target's share of the mass above which a fit says nothing."""

_LEAST_TRAVEL = 1e-12
"""Smallest motion of a base that can be compared [m]."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """Unit and point of the base's position, and their fit.

    Attributes:
        unit: a key of `UNITS`.
        is_origin: whether the positions are those of B's origin.
        fit: the fit with these conventions.

    """

    unit: str
    is_origin: bool
    fit: TravelFit

    @property
    def sentence(self) -> str:
        """What is wrong, and the remedy."""
        texts = []
        if self.unit != "m":
            texts.append(
                f"the position seems to be in {_UNIT_WORDS[self.unit]} (it must be in m), or "
                "masses of the model are wrong: no target could let this base move so far"
            )
        if not self.is_origin:
            place = ", ".join(f"{entry:.3g}" for entry in self.fit.point_B)
            texts.append(
                f"the position seems to be that of the point [{place}] m in B instead of B's "
                "origin (position.point_B of a map of columns), or the model's base has another "
                "mass or centre of mass"
            )
        return "; and ".join(texts)


@dataclass(frozen=True, eq=False)
class Variant:
    """A log in a convention of attitudes, joints or axes.

    Attributes:
        text: the error message if the log is in this convention; empty for the expected one.
        explanation: the best explanation of the positions; None if there is none that is possible.
        least: the smallest score of all fits, also of impossible targets and points.

    """

    text: str
    explanation: Explanation | None
    least: float

    @property
    def score(self) -> float:
        """The residual relative to the motion; infinite unless a possible target explains it."""
        if self.explanation is None or self.explanation.fit.error > _EQUAL * self.least:
            return np.inf
        return self.explanation.fit.error


@dataclass(frozen=True, eq=False)
class MotionFindings(Findings):
    """Contradictions between a log and the conservation of momentum.

    Attributes:
        unchecked: what could not be compared, each with the reason.

    """

    unchecked: list[str] = field(default_factory=list)


def check_motion(
    tree: KinematicTree, joint_names: tuple[str, ...], measurements: Measurements
) -> MotionFindings:
    """Compare the base's positions with those that the conservation of momentum allows.

    Finds positions in another unit than metres, in B's axes or of another point than B's origin,
    joint angles in degrees, a joint with the opposite sign, and quaternions of another order or
    direction. Because a wrong model of the spacecraft is explained in part by some convention, a
    convention is an error only if it explains the motion down to its noise and clearly better than
    the expected one, or if it is a much smaller unit.

    Args:
        tree: the known spacecraft.
        joint_names: its joints.
        measurements: screened samples, joints in the spacecraft's order.

    """
    found = MotionFindings()
    travel = base_travel(measurements)
    if travel is None or np.ptp(travel.position, axis=0).max() < _LEAST_TRAVEL:
        needs = "needs positions of a moving base, attitudes and joint positions"
        found.unchecked.append(f"unit and point of the position, signs of joints ({needs})")
        return found
    expected = explained(tree, travel)
    others = _variants(tree, joint_names, travel) if expected.score > 1e-3 else iter(())
    best = min((expected, *others), key=lambda variant: variant.score)
    if best.text and _is_better(best, expected, travel):
        found.errors.append(best.text)
        return found
    house = expected.explanation
    if house is None or not np.isfinite(expected.score):
        found.unchecked.append("unit and point of the position (no target explains the motion)")
        return found
    plain = TravelModel(tree, travel.q).fit(travel)
    is_clear = not plain.is_possible or plain.error > _CLEARLY * house.fit.error
    if house.unit == "m":
        # A model whose base has a slightly wrong centre of mass looks like a point close by.
        is_far = float(np.linalg.norm(house.fit.point_B)) > _FAR * house.fit.reach
        if not house.is_origin and plain.error > _EQUAL * house.fit.error:
            is_certain = is_far and is_clear and house.fit.is_complete
            (found.errors if is_certain else found.warnings).append(house.sentence)
        elif expected.score > _EXPLAINS:
            found.unchecked.append(
                "point of the position, signs of joints (no motion explains the positions closely)"
            )
        return found
    if UNITS[house.unit] > 1 / _MOST_WRONG:
        is_clear = is_clear and house.fit.is_complete
    (found.errors if is_clear else found.warnings).append(house.sentence)
    return found


def _is_better(variant: Variant, expected: Variant, travel: BaseTravel) -> bool:
    """Return whether another convention leaves only noise, and the expected one clearly more."""
    if variant.explanation is None or not variant.score < _EXPLAINS:
        return False
    return (
        variant.explanation.fit.is_complete
        and expected.least > _CLEARLY * variant.score
        and _is_significant(expected.least, variant.score, travel.position.size)
    )


def not_checked(measurements: Measurements, has_spacecraft: bool) -> list[str]:
    """Return what the comparison of positions with rates leaves unchecked, with the reason."""
    if has_spacecraft:
        return []
    texts = []
    if len(measurements.position):
        texts.append("units of position (needs --spacecraft)")
        texts.append("whether the position is that of the base's origin (needs --spacecraft)")
    if not len(measurements.joint_rates):
        texts.append("units of joint positions (needs --spacecraft or joint rates)")
    texts.append("signs of joints (needs --spacecraft)")
    if len(measurements.attitude) and not len(measurements.gyro):
        texts.append("order and direction of the quaternion (needs angular velocity)")
    return texts


def _variants(
    tree: KinematicTree, joint_names: tuple[str, ...], travel: BaseTravel
) -> Iterator[Variant]:
    """Yield the log in each other convention."""
    as_read = Rotation.from_matrix(travel.R_WB).as_quat(scalar_first=True)
    xyzw = Rotation.from_quat(as_read).as_matrix()  # if its entries are x, y, z, w
    order = "the quaternion seems to be in the order x, y, z, w; it must be qw, qx, qy, qz"
    inverse = "the quaternion seems to be that of R_BW; it must be that of R_WB, B's axes in W"
    turned = np.swapaxes(travel.R_WB, 1, 2)
    for text, R_WB in (
        (order, xyzw),
        (inverse, turned),
        (f"{order}; and {inverse}", np.swapaxes(xyzw, 1, 2)),
    ):
        yield explained(tree, replace(travel, R_WB=R_WB), text)
    text = "the joint positions q:<joint> seem to be in degrees; they must be in rad"
    yield explained(tree, in_degrees(tree, travel), text)
    text = "the position x, y, z seems to be expressed in B's axes; it must be in W's axes"
    yield explained(tree, replace(travel, position=rotate(travel.R_WB, travel.position)), text)
    for k, name in enumerate(joint_names):
        if not tree.is_rotor(k):
            signs = np.where(np.arange(len(joint_names)) == k, -1.0, 1.0)
            text = f"q:{name} seems to have the opposite sign of the model's joint"
            yield explained(tree, replace(travel, q=signs * travel.q), text)


def in_degrees(tree: KinematicTree, travel: BaseTravel) -> BaseTravel:
    """Return a motion whose turning joints are in degrees instead of radians."""
    turning = [body.joint for body in tree.bodies if body.joint >= 0 and not body.prismatic]
    q = travel.q.copy()
    q[:, turning] = np.radians(q[:, turning])
    return replace(travel, q=q)


def explained(tree: KinematicTree, travel: BaseTravel, text: str = "") -> Variant:
    """Return the simplest unit and point of the position that explain a motion as well as any.

    Args:
        tree: the known spacecraft.
        travel: the logged motion, in the convention to score.
        text: the error message if the log is in this convention.

    """
    model = TravelModel(tree, travel.q)
    candidates = [
        Explanation(unit, is_origin, model.fit(in_unit(travel, scale), free_point=not is_origin))
        for is_origin in (True, False)
        for unit, scale in UNITS.items()
    ]
    possible = [candidate for candidate in candidates if candidate.fit.is_possible]
    least = min(candidate.fit.error for candidate in candidates)
    if not possible:
        return Variant(text, None, least)
    best, count = min(candidate.fit.error for candidate in possible), travel.position.size
    simplest = next(c for c in possible if not _is_significant(c.fit.error, best, count))
    if simplest is not candidates[0]:
        # A constant force, such as a leaking thruster's, is no reason to doubt the conventions.
        pushed = model.fit(travel, constant_force=True)
        is_possible = pushed.is_possible and pushed.mass_share_sigma < _UNDETERMINED
        if is_possible and not _is_significant(pushed.error, best, count):
            return Variant(text, Explanation("m", True, pushed), least)
    return Variant(text, simplest, least)


def _is_significant(error: float, best: float, count: int) -> bool:
    """Return whether residuals are larger than the best by more than their noise explains."""
    return bool(count * ((error / best) ** 2 - 1) > _SIGNIFICANT)
