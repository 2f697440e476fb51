from .momentum_rows import changed_motion

__all__ = [
    "changed_motion",
]
