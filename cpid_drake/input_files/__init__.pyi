from .validation import load_yaml, nulls

__all__ = [
    "load_yaml",
    "nulls",
]
