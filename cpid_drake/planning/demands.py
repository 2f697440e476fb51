"""Constraints that depend on the target, imposed for those targets that need the most.

A planner has a few plausible targets. Torques and the base's motion are largest with heavy targets,
so many of them are examined, and the constraints are imposed for those with the largest values.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.planning.base_limits import BaseLimit
from cpid_drake.planning.efforts import SHARE, JointEfforts
from cpid_drake.planning.objective import Objective, PlausibleTarget
from cpid_drake.planning.prediction import MotionSetting

EXCESS = 0.02
"""Share by which a value may exceed what is imposed before a target is added."""

HIGH_EFFORT = 0.3
"""Share of a joint's largest effort above which it is constrained."""

TARGETS_ADDED = 3
"""Number of targets that are added at once for a limit of the base's motion."""

DENSE_PERIOD = 0.05
"""Time between the instants at which the base's motion is checked [s]."""


@dataclass(eq=False)
class TargetDemands:
    """The limits of joint efforts and of the base's motion.

    Attributes:
        setting: the spacecraft and its momentum.
        many: the objective with many targets.
        base_limits: the limits of the base's motion.
        efforts: the limits of joint efforts; None until `begin`, or if no joint needs much.
        targets: those of the many targets that need the most.

    """

    setting: MotionSetting
    many: Objective
    base_limits: list[BaseLimit]
    efforts: JointEfforts | None = None
    targets: tuple[PlausibleTarget, ...] = ()

    @property
    def constraints(self) -> list[BaseLimit | JointEfforts]:
        """All constraints."""
        return [*self.base_limits, *([] if self.efforts is None else [self.efforts])]

    def begin(self, parameters: NDArray[np.float64]) -> None:
        """Choose the targets, and the joints whose efforts are limited, by motions (B, F, K)."""
        largest = self.setting.spacecraft.limits.efforts
        efforts = JointEfforts(self.many, np.arange(largest.size), largest)
        shares = efforts.demands(parameters)
        joints = np.flatnonzero(shares.max(axis=0) > HIGH_EFFORT)
        self._add(np.unique(shares[:, joints].argmax(axis=0)))
        for each in self.base_limits:
            demands = replace(each, objective=self.many).demands(parameters)
            self._add(_largest(demands))
        if joints.size:
            self.efforts = replace(efforts, joints=joints)
        self._impose()

    def demand_more(self, parameters: NDArray[np.float64]) -> bool:
        """Add the targets with which a motion (F, K) exceeds a limit; return whether it does."""
        largest, before = self.setting.spacecraft.limits.efforts, len(self.targets)
        efforts = JointEfforts(self.many, np.arange(largest.size), largest)
        shares = efforts.demands(parameters[None])
        high = np.flatnonzero(shares.max(axis=0) > 1 + EXCESS)
        self._add(np.unique(shares[:, high].argmax(axis=0)))
        for each in self.base_limits:
            demands = replace(each, objective=self.many).demands(parameters[None])
            self._add(_largest(demands * (demands > 1 + EXCESS)))
        is_more = len(self.targets) > before
        if is_more and high.size:
            imposed = self.efforts or replace(efforts, joints=high)
            self.efforts = replace(imposed, joints=np.union1d(imposed.joints, high))
        self._impose()
        return is_more

    def needed(self, motion: JointMotion, targets: NDArray[np.float64]) -> "Needed":
        """Return what a motion needs in Drake's plant with targets of parameters π (T, 10)."""
        setting = self.setting
        efforts = setting.largest_efforts(motion, targets)
        limits = setting.spacecraft.limits.efforts
        base = np.zeros(len(self.base_limits))
        times = np.linspace(0.0, motion.duration, int(motion.duration / DENSE_PERIOD) + 2)
        for moved in setting.telemetries(motion, targets, times) if self.base_limits else []:
            reached = [each.measured(moved) / each.largest for each in self.base_limits]
            base = np.maximum(base, reached)
        return Needed(np.asarray(np.max(efforts, axis=0) / limits), base)

    def tighten(self, parameters: NDArray[np.float64], needed: "Needed") -> None:
        """Impose less where a motion (F, K) needs more between the nodes than at the nodes."""
        if self.efforts is not None:
            joints, limits = self.efforts.joints, self.setting.spacecraft.limits.efforts
            over = needed.efforts[joints] > 1
            imposed = self.efforts.demands(parameters[None]).max(axis=0)[over]
            joints, largest = joints[over], self.efforts.largest.copy()
            at_nodes = imposed * SHARE * largest[joints]
            peak = needed.efforts[joints] * limits[joints] / at_nodes
            largest[joints] = np.minimum(largest[joints], limits[joints] / (1.02 * SHARE * peak))
            self.efforts = replace(self.efforts, largest=largest)
        tightened = []
        for each, share in zip(self.base_limits, needed.base, strict=True):
            at_nodes = each.imposed * float(each.demands(parameters[None]).max())
            imposed = min(each.imposed, 0.995 * at_nodes / max(share, at_nodes))
            tightened.append(replace(each, imposed=imposed))
        self.base_limits = tightened

    def _add(self, numbers: NDArray[np.intp]) -> None:
        """Add some of the many targets."""
        chosen = [self.many.targets[k] for k in numbers]
        new = [each for each in chosen if not any(each is known for known in self.targets)]
        self.targets = (*self.targets, *new)

    def _impose(self) -> None:
        """Impose the constraints for the chosen targets."""
        if self.targets:
            demanding = replace(self.many, targets=self.targets)
            self.base_limits = [replace(each, objective=demanding) for each in self.base_limits]
            if self.efforts is not None:
                self.efforts = replace(self.efforts, objective=demanding)


@dataclass(frozen=True, eq=False)
class Needed:
    """What a motion needs with some targets, as shares of the limits.

    Attributes:
        efforts: (J,) largest joint efforts.
        base: (Q,) largest values of the base's motion, in the order of the limits.

    """

    efforts: NDArray[np.float64]
    base: NDArray[np.float64]

    @property
    def largest(self) -> float:
        """The largest share."""
        return float(max(self.efforts.max(initial=0.0), self.base.max(initial=0.0)))


def _largest(demands: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the numbers of the targets with the largest positive demands (T, 1)."""
    order = np.argsort(-demands[:, 0], kind="stable")[:TARGETS_ADDED]
    return order[demands[order, 0] > 0]
