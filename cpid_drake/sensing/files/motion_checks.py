"""Compares a log with the conservation of momentum, to find wrong units, points and conventions.

`sensing.files.consistency` compares positions with rates. The checks here need no rates, but the
spacecraft: they ask which conventions make the base move as its centre of mass allows.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.errors import InputError
from cpid_drake.sensing.files.centre_of_mass import (
    BaseTravel,
    TravelFit,
    TravelModel,
    base_travel,
    in_unit,
    small_error_residuals,
)
from cpid_drake.sensing.files.consistency import Findings
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.noise_estimation import noise_level

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254, "ft": 0.3048, "10 m": 10.0}
"""Units that positions may be in, by their size in metres; the first is the expected one."""

_UNIT_WORDS = {
    **{"mm": "millimetres", "cm": "centimetres", "in": "inches", "ft": "feet"},
    "10 m": "units of 10 m",
}
_SIGNIFICANT = 50.0
"""Smallest increase of the sum of squared residuals, in units of their variance, that counts."""

_EQUAL = 1.25
"""Ratio up to which a possible target explains the motion as well as an impossible one."""

_CLEAR = 2.0
"""Ratio of the residuals above which a wrong convention is certain."""

_EXPLAINS = 0.7
"""Largest residual of a fit that explains the motion, as a share of the motion."""

_FAR = 0.05
"""Distance of a point from B's origin, in reaches of the arm, that model errors do not explain."""

_MOST_WRONG = 10.0
"""Ratio by which no model's masses are wrong; a unit can differ from metres by more."""

_UNDETERMINED = 0.2
"""σ of the target's share of the mass above which a fit says nothing."""

_DRAWS = 4
"""Number of draws of noise by which a bias is estimated."""

_BIASES = 8.0
"""Distance of a point from B's origin, in biases, that is more than bias."""

_LEAST_TRAVEL = 1e-12
"""Smallest motion of a base that can be compared [m]."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """Conventions of the base's position and their fit.

    Attributes:
        unit: a key of `UNITS`.
        is_origin: whether the positions are those of B's origin.
        fit: the fit with these conventions.

    """

    unit: str
    is_origin: bool
    fit: TravelFit


@dataclass(frozen=True, eq=False)
class Variant:
    """A log in other conventions of attitudes or joints.

    Attributes:
        text: the error message if the log is in these conventions; empty for the expected ones.
        order: order of the quaternion as it was read, "wxyz" or "xyzw".
        direction: direction of the quaternion as it was read, "R_WB" or "R_BW".
        degrees: whether the joint angles are in degrees.
        reversed_joint: index of a joint with the opposite sign; −1 for none.
        is_in_B: whether the positions are expressed in B's axes.
        explanation: the best explanation of the positions; None if there is none that is possible.
        least_error: the smallest error of all fits, also of impossible targets and points.

    """

    text: str
    order: str = "wxyz"
    direction: str = "R_WB"
    degrees: bool = False
    reversed_joint: int = -1
    is_in_B: bool = False
    explanation: Explanation | None = None
    least_error: float = np.inf

    @property
    def error(self) -> float:
        """The residual relative to the motion; infinite unless a possible target explains it."""
        if self.explanation is None or self.explanation.fit.error > _EQUAL * self.least_error:
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
    convention is an error only if it explains the motion down to its noise, or if it is a much
    smaller unit. A joint has the opposite sign only if small errors of the hardware do not explain
    the motion as well.

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
    expected, best = compare_variants(tree, joint_names, travel)
    if best.text and is_better(best, expected, len(travel.time)):
        if best.reversed_joint >= 0 and _is_hardware(tree, travel, best):
            found.unchecked.append(
                "signs of joints (late or turned sensors may explain the motion)"
            )
            return found
        report = found.errors if expected.least_error > _CLEAR * best.error else found.warnings
        report.append(best.text)
        return found
    house = expected.explanation
    if house is None or not np.isfinite(expected.error):
        found.unchecked.append("unit and point of the position (no target explains the motion)")
    elif house.unit == "m" and (house.is_origin or _is_bias(tree, travel, measurements, house)):
        pass
    elif house.unit != "m" or expected.error < _EXPLAINS:
        plain = TravelModel(tree, travel.q).fit(travel)
        is_clear = not plain.is_possible or plain.error > _CLEAR * house.fit.error
        if house.unit == "m":
            # A model whose base has a slightly wrong centre of mass looks like a point close by.
            is_clear = is_clear and bool(np.linalg.norm(house.fit.point_B) > _FAR * house.fit.reach)
        if UNITS[house.unit] > 1 / _MOST_WRONG:
            is_clear = is_clear and house.fit.is_complete
        (found.errors if is_clear else found.warnings).append(_explained(house))
    if house is not None and house.unit == "m" and _EXPLAINS < expected.error < np.inf:
        found.unchecked.append(
            "point of the position, signs of joints (no motion explains the positions closely)"
        )
    return found


def _is_hardware(tree: KinematicTree, travel: BaseTravel, best: Variant) -> bool:
    """Return whether small errors of the hardware explain a motion as well as other conventions."""
    expected = TravelModel(tree, travel.q).fit(travel, constant_force=True)
    if not expected.is_possible:
        return False
    rest = small_error_residuals(tree, travel, expected)
    error = float(np.sqrt(np.mean(rest**2))) / max(expected.travel, 1e-300)
    return not _is_significant(error, best.error, expected.count)


def _is_bias(
    tree: KinematicTree, travel: BaseTravel, measurements: Measurements, found: Explanation
) -> bool:
    """Return whether noise of attitudes and encoders can be the reason of a point off the origin.

    Noise in the regressors of least squares biases the estimate in proportion to its variance, so
    as much noise again, drawn from a fixed seed, shows the bias (simulation extrapolation, Cook and
    Stefanski 1994).
    """
    try:
        turns = noise_level(measurements.attitude, quaternions=True)
        angles = noise_level(measurements.encoders)
    except InputError:  # the times are too uneven to estimate noise
        return False
    rng, shifts = np.random.default_rng(1), []
    for _ in range(_DRAWS):
        noise = Rotation.from_rotvec(turns * rng.normal(size=(len(travel.time), 3)))
        q = travel.q + angles * rng.normal(size=travel.q.shape)
        noisy = replace(travel, R_WB=travel.R_WB @ noise.as_matrix(), q=q)
        shifts.append(TravelModel(tree, q).fit(noisy, free_point=True).point_B)
    bias = np.mean(shifts, axis=0) - found.fit.point_B
    return bool(np.linalg.norm(found.fit.point_B) < _BIASES * np.linalg.norm(bias))


def is_better(variant: Variant, expected: Variant, count: int) -> bool:
    """Return whether other conventions explain `count` positions, and clearly better.

    They leave only noise, and the expected conventions leave significantly more.
    """
    if variant.explanation is None or not variant.error < _EXPLAINS:
        return False
    if not variant.explanation.fit.is_complete:
        return False
    return _is_significant(expected.least_error, variant.error, 3 * count)


def compare_variants(
    tree: KinematicTree,
    joint_names: tuple[str, ...],
    travel: BaseTravel,
    *,
    others: bool = True,
) -> tuple[Variant, Variant]:
    """Return the variant with the expected conventions, and the one that explains the log best.

    Args:
        tree: the known spacecraft.
        joint_names: its joints.
        travel: the logged motion in the expected conventions.
        others: whether other conventions of attitudes and joints are compared as well.

    """
    expected = _explain(Variant(""), tree, travel)
    variants = [expected]
    if others and expected.error > 1e-3:
        variants += [_explain(other, tree, travel) for other in _variants(tree, joint_names)]
    return expected, min(variants, key=lambda variant: variant.error)


def not_checked(measurements: Measurements, has_spacecraft: bool) -> list[str]:
    """Return what the comparison of positions with rates leaves unchecked, with the reason."""
    texts = []
    if len(measurements.position) and not has_spacecraft:
        texts.append("units of position (needs --spacecraft)")
        texts.append("whether the position is that of the base's origin (needs --spacecraft)")
    if not len(measurements.joint_rates) and not has_spacecraft:
        texts.append("units of joint positions (needs --spacecraft or joint rates)")
    if not has_spacecraft:
        texts.append("signs of joints (needs --spacecraft)")
    if len(measurements.attitude) and not len(measurements.gyro) and not has_spacecraft:
        texts.append("order and direction of the quaternion (needs angular velocity)")
    return texts


def _variants(tree: KinematicTree, joint_names: tuple[str, ...]) -> Iterator[Variant]:
    order = "the quaternion seems to be in the order x, y, z, w; it must be qw, qx, qy, qz"
    inverse = "the quaternion seems to be that of R_BW; it must be that of R_WB, B's axes in W"
    yield Variant(order, order="xyzw")
    yield Variant(inverse, direction="R_BW")
    yield Variant(f"{order}; and {inverse}", order="xyzw", direction="R_BW")
    yield Variant(
        "the joint positions q:<joint> seem to be in degrees; they must be in rad", degrees=True
    )
    place = "the position x, y, z seems to be expressed in B's axes; it must be in W's axes"
    yield Variant(place, is_in_B=True)
    rotors = [k for k in range(len(joint_names)) if tree.is_rotor(k)]
    for k, name in enumerate(joint_names):
        if k not in rotors:
            text = f"q:{name} seems to have the opposite sign of the model's joint"
            yield Variant(text, reversed_joint=k)


def _explain(variant: Variant, tree: KinematicTree, travel: BaseTravel) -> Variant:
    """Return a variant with its best explanation of the logged motion."""
    q, R_WB = travel.q.copy(), travel.R_WB
    if variant.degrees:
        turning = [body.joint for body in tree.bodies if body.joint >= 0 and not body.prismatic]
        q[:, turning] = np.radians(q[:, turning])
    if variant.reversed_joint >= 0:
        q[:, variant.reversed_joint] *= -1
    if variant.order == "xyzw":
        as_read = Rotation.from_matrix(R_WB).as_quat(scalar_first=True)
        R_WB = Rotation.from_quat(as_read).as_matrix()  # its entries are x, y, z, w
    if variant.direction == "R_BW":
        R_WB = np.swapaxes(R_WB, -1, -2)
    position = rotate(R_WB, travel.position) if variant.is_in_B else travel.position
    moved = replace(travel, position=position, R_WB=R_WB, q=q)
    explanation, least_error = best_explanation(TravelModel(tree, q), moved)
    return replace(variant, explanation=explanation, least_error=least_error)


def best_explanation(model: TravelModel, travel: BaseTravel) -> tuple[Explanation | None, float]:
    """Return the simplest conventions of the position that explain the motion as well as any.

    Args:
        model: the spacecraft with the joint positions of the log.
        travel: the logged motion.

    Returns:
        The explanation, None if no target can be the reason of the motion in any of the units; and
        the smallest error of all fits, also of impossible targets and points.

    """
    candidates = [
        Explanation(unit, is_origin, model.fit(in_unit(travel, scale), free_point=not is_origin))
        for is_origin in (True, False)
        for unit, scale in UNITS.items()
    ]
    possible = [candidate for candidate in candidates if candidate.fit.is_possible]
    least = min(candidate.fit.error for candidate in candidates)
    if not possible:
        return None, least
    best = min(candidate.fit.error for candidate in possible)
    count = possible[0].fit.count
    simplest = next(c for c in possible if not _is_significant(c.fit.error, best, count))
    if simplest is not candidates[0]:
        # A constant force, such as a leaking thruster's, is no reason to doubt the conventions.
        pushed = model.fit(travel, constant_force=True)
        is_possible = pushed.is_possible and pushed.mass_share_sigma < _UNDETERMINED
        if is_possible and not _is_significant(pushed.error, best, count):
            return Explanation("m", True, pushed), least
    return simplest, least


def _is_significant(error: float, best: float, count: int) -> bool:
    """Return whether residuals are larger than the best by more than their noise explains."""
    return bool(count * ((error / best) ** 2 - 1) > _SIGNIFICANT)


def _explained(found: Explanation) -> str:
    """Return the message about positions in other conventions."""
    texts = []
    if found.unit != "m":
        extent = "far" if UNITS[found.unit] < 1 else "little"
        texts.append(
            f"the position seems to be in {_UNIT_WORDS[found.unit]} (it must be in m), or masses "
            f"of the model are wrong: no target could let this base move so {extent}"
        )
    if not found.is_origin:
        place = ", ".join(f"{entry:.3g}" for entry in found.fit.point_B)
        texts.append(
            f"the position seems to be that of the point [{place}] m in B instead of B's origin "
            "(position.point_B of a map of columns), or the model's base has another mass or "
            "centre of mass"
        )
    return "; and ".join(texts)
