from .sensors import Gyro

__all__ = [
    "Gyro",
]
