from .ports import SpacecraftSystem

__all__ = [
    "SpacecraftSystem",
]
