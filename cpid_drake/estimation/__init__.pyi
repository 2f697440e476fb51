from .momentum_rows import changed

__all__ = [
    "changed",
]
