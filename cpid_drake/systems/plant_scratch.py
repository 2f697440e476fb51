"""Contexts of a plant for intermediate results."""

import threading

from pydrake.multibody.plant import MultibodyPlant


class PlantScratch(threading.local):
    """A context of a plant that a system overwrites at every call; it holds no state.

    Every thread has its own, so that one Diagram can run in many Contexts at a time.
    """

    def __init__(self, plant: MultibodyPlant) -> None:
        self.context = plant.CreateDefaultContext()
