"""The total momentum of spacecraft and target: zero, an unknown constant, or known."""

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from cpid_drake.array import Array
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import standard_to_relative
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.files.errors import InputError


@dataclass(frozen=True, eq=False)
class TotalMomentum:
    """The constant momentum of spacecraft and target, about the system's centre of mass Scm.

    About Scm, the conservation of angular momentum is independent of the base's position and
    velocity.

    Attributes:
        L_WScm_W: (3,) angular momentum about Scm, in W [N·m·s]; the initial value if it is unknown.
        v_WScm_W: (3,) velocity of Scm, in W [m/s]; the initial value if it is unknown.
        is_unknown: whether an estimator has to estimate the momentum.

    Raises:
        InputError: a vector does not consist of three finite numbers.

    """

    L_WScm_W: Array = field(default_factory=lambda: np.zeros(3))
    v_WScm_W: Array = field(default_factory=lambda: np.zeros(3))
    is_unknown: bool = False

    def __post_init__(self) -> None:
        for name in ("L_WScm_W", "v_WScm_W"):
            vector = _vector(name, getattr(self, name), 3)
            vector.flags.writeable = False
            object.__setattr__(self, name, vector)

    @classmethod
    def zero(cls) -> Self:
        """Return a momentum of zero."""
        return cls()

    @classmethod
    def unknown(cls, initial: "TotalMomentum | None" = None) -> Self:
        """Return an unknown momentum, which estimators start at `initial` (default: zero)."""
        start = initial or cls()
        return cls(start.L_WScm_W, start.v_WScm_W, is_unknown=True)

    @classmethod
    def with_base_at_origin(
        cls, tree: KinematicTree, target: InertialParameters, q: ArrayLike, momentum_W: ArrayLike
    ) -> Self:
        """Return a known momentum of a system whose base frame B coincides with W.

        It is [L; P] (6,) about W's origin, in W [N·m·s, N·s], at joint positions q (J,) [rad or m].
        """
        q = np.asarray(q, dtype=float)[None]
        psi = standard_to_relative(target.to_standard_vector(), tree.mass)
        p_WScm = BodyDynamics.at(tree, q, 0 * q).com(psi)[0]
        L_W, P_W = np.split(_vector("momentum_W", momentum_W, 6), 2)
        return cls(L_W - np.cross(p_WScm, P_W), P_W / (tree.mass + target.mass))

    @classmethod
    def named(cls, name: str) -> Self:
        """Return the momentum of this name, zero or unknown; raises InputError for another one."""
        if name not in ("zero", "unknown"):
            raise InputError(f"no momentum '{name}'; choose from zero, unknown")
        return cls.unknown() if name == "unknown" else cls.zero()

    @classmethod
    def of(cls, given: "TotalMomentum | str | None") -> "TotalMomentum | None":
        """Return an argument as a momentum, which may be its name; see `named`.

        Raises:
            InputError: it is neither.

        """
        if given is None or isinstance(given, TotalMomentum):
            return given
        if isinstance(given, str):
            return cls.named(given)
        raise InputError(f"momentum must be a TotalMomentum, zero, or unknown, not {given!r:.80}")

    @property
    def is_zero(self) -> bool:
        """Whether the momentum is known to be zero."""
        return not (self.is_unknown or self.L_WScm_W.any() or self.v_WScm_W.any())

    @property
    def name(self) -> str:
        """One word: zero, unknown or known."""
        return "unknown" if self.is_unknown else "zero" if self.is_zero else "known"


def _vector(name: str, value: ArrayLike, size: int) -> Array:
    try:
        vector = np.array(value, dtype=float)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (size,) or not np.isfinite(vector).all():
        raise InputError(f"total momentum: {name} must be {size} finite numbers, not {value!r}")
    return vector
