from .joint_motions import MOTION_TAGS as MOTION_TAGS
