"""External forces and torques on the spacecraft: their σ."""

from dataclasses import dataclass

from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.files.errors import InputError
from cpid_drake.sensors.sensors import Stated


@dataclass
class Disturbances:
    """σ of external forces and torques: None if not stated, zero if there are none.

    The acceleration is that of the centre of mass of spacecraft and target. The torque is that
    about this centre. Both are expressed in W. Drag, a leaking valve, gravity gradient over a short
    time or a table out of level cause such disturbances.

    Attributes:
        acceleration: σ of each coordinate of a constant acceleration [m/s²].
        torque: σ of each coordinate of a constant torque [N·m].
        acceleration_noise: white acceleration, as of an air-bearing floor: the velocity changes in
            a time t by this value times √t [m/s²/√Hz].
        torque_noise: white torque: the angular momentum changes likewise [N·m/√Hz].
        acceleration_walk: random walk of the acceleration: it changes in a time t by this value
            times √t [m/s²/√s].
        torque_walk: random walk of the torque [N·m/√s].
        acceleration_B, torque_B: the same in B, as of a leak [m/s², N·m]. No seed draws them.
        acceleration_B_walk, torque_B_walk: their random walks [m/s²/√s, N·m/√s].
        thrust_scale: σ of the error of the scale of logged thrust: the true thrust is the logged
            one times one plus this error, common to all its components.
        joint_compliance_urad: σ of the compliance of each joint: its angle is the encoder's less so
            much per effort that moves what is outboard of it [10⁻⁶ rad/(N·m); of prismatic joints
            10⁻⁶ m/N]. No seed draws it.
        compliance_urad: σ of the compliance of the grasp about each axis of C: the target rotates
            against C by so much per moment [10⁻⁶ rad/(N·m)]. No seed draws it: simulations have a
            wrist of their own.
        translational_compliance_um: the same along each axis of C: the target moves against C by so
            much per force [10⁻⁶ m/N].
        wheel: σ of each coordinate, in B, of the constant angular momentum of rotors in the base
            that the spacecraft's model has not [N·m·s]. No seed draws it.
        target_wheel: the same in C, of rotors in the target.
        orbit: orbit of W's origin, whose gravity gradient rotates the system and moves its centre
            of mass; None for none. It is known, and has no σ.

    Raises:
        InputError: a random walk without the σ at its start.

    """

    acceleration: Stated = None
    torque: Stated = None
    acceleration_noise: Stated = None
    torque_noise: Stated = None
    acceleration_walk: Stated = None
    torque_walk: Stated = None
    acceleration_B: Stated = None
    torque_B: Stated = None
    acceleration_B_walk: Stated = None
    torque_B_walk: Stated = None
    thrust_scale: Stated = None
    joint_compliance_urad: Stated = None
    compliance_urad: Stated = None
    translational_compliance_um: Stated = None
    wheel: Stated = None
    target_wheel: Stated = None
    orbit: Orbit | None = None

    def __post_init__(self) -> None:
        for name in ("acceleration", "torque", "acceleration_B", "torque_B"):
            if getattr(self, f"{name}_walk") and not getattr(self, name):
                raise InputError(f"{name}_walk needs {name}, the σ at the start")
