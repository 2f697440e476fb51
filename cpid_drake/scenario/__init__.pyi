from .joint_motions import MOTION_TAGS as MOTION_TAGS
from .trials import fit_errors as fit_errors
from .trials import make_case as make_case
