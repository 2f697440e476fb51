from .files import files_of
from .joint_motions import HalfCosineMotion, MotionFile, write_joint_table
from .limits import check_limits
from .noise import add_noise
from .schema import SpacecraftConfig
from .trials import Case, base_trajectory, bound_of, fit_errors, ideal_samples, make_case, seeds_of

__all__ = [
    "Case",
    "HalfCosineMotion",
    "MotionFile",
    "SpacecraftConfig",
    "add_noise",
    "base_trajectory",
    "bound_of",
    "check_limits",
    "files_of",
    "fit_errors",
    "ideal_samples",
    "make_case",
    "seeds_of",
    "write_joint_table",
]
