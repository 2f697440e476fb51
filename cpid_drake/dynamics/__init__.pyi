from .body_dynamics import BodyDynamics
from .joint_motion import SPLINE_DEGREE
from .momentum import momentum_samples, system_momentum
from .outboard import Outboard, cross_force, cross_motion
from .parameterizations import (
    SCALE_LENGTH,
    STANDARD,
    Parameterization,
    moved_moments,
    parameter_scale,
    relative_parameterization,
    standard_to_relative,
    tensor_to_vector,
)
from .propagation import propagate
from .rotations import rotate, skew
from .rows import ROW_FAMILIES, inertia_operator
from .sensitivity import perturbed
from .tree import KinematicTree

__all__ = [
    "ROW_FAMILIES",
    "SCALE_LENGTH",
    "SPLINE_DEGREE",
    "STANDARD",
    "BodyDynamics",
    "KinematicTree",
    "Outboard",
    "Parameterization",
    "cross_force",
    "cross_motion",
    "inertia_operator",
    "momentum_samples",
    "moved_moments",
    "parameter_scale",
    "perturbed",
    "propagate",
    "relative_parameterization",
    "rotate",
    "skew",
    "standard_to_relative",
    "system_momentum",
    "tensor_to_vector",
]
