"""Logs of another spacecraft, payload, momentum or noise than the user says."""

from dataclasses import replace

import log_noise as noise
import log_spoils as spoil
import log_trees as trees
import log_words as words
import numpy as np
from log_case import Case
from log_sources import Motion

from cpid_drake.sensing.sensors import AttitudeSensor, VectorSensor
from cpid_drake.studies.trials import Firing

G = 9.81
"""Gravity [m/s²]."""

_MORE = np.array([0.0, 0.05, 0.0])

MODELS = {
    "bus_mass_double": Case(
        "model", "arms_flight", words.MODEL, motion=Motion(trees.heavier("bus", 2.0, 1.0))
    ),
    "bus_inertia_30": Case(
        "model", "arms_flight", words.MODEL, motion=Motion(trees.heavier("bus", 1.0, 1.3))
    ),
    "bus_mass_exact": Case(
        "model", "paper_exact", words.MODEL, motion=Motion(trees.heavier("bus", 1.2, 1.0))
    ),
    "body_mass_flyer": Case(
        "model", "flyer_testbed", words.MODEL, motion=Motion(trees.heavier("body", 1.3, 1.3))
    ),
    "bus_com_5_cm": Case(
        "model",
        "arms_flight",
        words.MODEL,
        motion=Motion(trees.changed_body("bus", lambda b: replace(b, p_BBcm=b.p_BBcm + _MORE))),
    ),
    "wheel_inertia": Case(
        "model",
        "wheels_servicer",
        words.MODEL + "|wheel",
        motion=Motion(trees.heavier("wheel1", 1.0, 1.5)),
    ),
    "arm_link_mass": Case(
        "model",
        "arms_flight",
        words.MODEL,
        motion=Motion(trees.heavier("capture_arm_link2", 1.5, 1.5)),
    ),
    "joint_axis_sign": Case(
        "model",
        "wheels_servicer",
        words.JOINT,
        motion=Motion(trees.changed_body("arm_link4", lambda b: replace(b, axis_F=-b.axis_F))),
    ),
    "link_length": Case(
        "model",
        "arms_flight",
        words.MODEL,
        motion=Motion(
            trees.changed_body("capture_arm_link3", lambda b: replace(b, p_PF=1.05 * b.p_PF))
        ),
    ),
    "link_length_exact": Case(
        "model",
        "flyer_exact",
        words.MODEL,
        motion=Motion(trees.changed_body("arm_link3", lambda b: replace(b, p_PF=1.1 * b.p_PF))),
    ),
    "arm_mount_10_cm": Case(
        "model",
        "arms_flight",
        words.MODEL,
        motion=Motion(
            trees.changed_body("capture_arm_link1", lambda b: replace(b, p_PF=b.p_PF + 2 * _MORE))
        ),
    ),
    "capture_frame_other_arm": Case(
        "model", "arms_flight", r"capture|frame|arm|model", capture_frame="operating_point"
    ),
    "capture_frame_inboard": Case(
        "model", "arms_flight", r"capture|frame|model", capture_frame="capture_arm_link4"
    ),
    "capture_frame_inboard_exact": Case(
        "model", "flyer_exact", r"capture|frame|model", capture_frame="arm_link2"
    ),
    "other_spacecraft": Case(
        "model",
        "three_arms_flight",
        words.MODEL,
        motion=Motion(
            lambda tree: replace(
                tree,
                bodies=tuple(
                    replace(b, mass=2 * b.mass) if b.parent >= 0 else b for b in tree.bodies
                ),
            )
        ),
    ),
}

PAYLOADS = {
    "payload_other_arm": Case(
        "payload",
        "arms_flight",
        words.PAYLOAD,
        motion=Motion(trees.payload("operating_arm_gripper", 20.0, [0.3, 0.0, 0.0], 0.2)),
    ),
    "payload_other_arm_exact": Case(
        "payload",
        "paper_exact",
        words.PAYLOAD,
        motion=Motion(trees.payload("operating_arm_gripper", 20.0, [0.3, 0.0, 0.0], 0.2)),
    ),
    "payload_base": Case(
        "payload",
        "arms_flight",
        words.PAYLOAD,
        motion=Motion(trees.payload("bus", 20.0, [0.5, 0.5, 0.5], 0.2)),
    ),
    "payload_base_servicer": Case(
        "payload",
        "wheels_servicer",
        words.PAYLOAD,
        motion=Motion(trees.payload("bus", 20.0, [-0.5, 0.3, 0.5], 0.2)),
    ),
    "payload_base_flyer": Case(
        "payload",
        "flyer_testbed",
        words.PAYLOAD,
        motion=Motion(trees.payload("body", 1.0, [-0.1, 0.0, 0.1], 0.05)),
    ),
    "payload_elbow": Case(
        "payload",
        "wheels_servicer",
        words.PAYLOAD,
        motion=Motion(trees.payload("arm_link4", 10.0, [0.0, 0.0, 0.0], 0.1)),
    ),
}

SLOW = (0.3, -0.2, 0.25, 0.04, 0.02, -0.03)
FIRED = (6.0, -4.0, 5.0, 3.0, -2.0, 2.0)

MOMENTA = {
    "tumble": Case("issue", "tumbling_flight", words.MOMENTUM, options=("--momentum", "zero")),
    "tumble_forgotten": Case("issue", "tumbling_flight", words.MOMENTUM),
    "tumble_eq18": Case("issue", "tumbling_flight", words.MOMENTUM, only=("--rows", "eq18")),
    "tumble_eq18_exact": Case("issue", "tumbling_exact", words.MOMENTUM, only=("--rows", "eq18")),
    "tumble_exact": Case("momentum", "tumbling_exact", words.MOMENTUM),
    "tumble_slow": Case("momentum", "arms_flight", words.MOMENTUM, motion=Motion(momentum_W=SLOW)),
    "tumble_slow_exact": Case(
        "momentum", "arms_exact", words.MOMENTUM, motion=Motion(momentum_W=SLOW)
    ),
    "tumble_flyer": Case(
        "momentum", "flyer_testbed", words.MOMENTUM, motion=Motion(turned=(0.02, -0.03, 0.01))
    ),
    "drift_1_cm_s": Case(
        "momentum",
        "wheels_servicer",
        words.MOMENTUM,
        motion=Motion(momentum_W=(0.0, 0.0, 0.0, 4.0, 2.0, -3.0)),
    ),
    "force_5_mN": Case(
        "momentum", "arms_flight", words.FORCE, motion=Motion(force_W=(5e-3, 0.0, 0.0))
    ),
    "force_5_mN_flyer": Case(
        "momentum", "flyer_testbed", words.FORCE, motion=Motion(force_W=(3e-3, 4e-3, 0.0))
    ),
    "force_5_mN_on_base": Case(
        "momentum",
        "arms_flight",
        words.FORCE,
        motion=Motion(force_W=(5e-3, 0.0, 0.0), point_B=(0.0, 1.0, 0.0)),
    ),
    "force_100_mN_exact": Case(
        "momentum",
        "arms_exact",
        words.FORCE,
        motion=Motion(force_W=(0.1, 0.0, 0.0), point_B=(0.0, 1.0, 0.0)),
    ),
    "table_out_of_level": Case(
        "momentum",
        "flyer_testbed",
        words.FORCE,
        motion=Motion(force_W=(19 * G * 2e-4, 0.0, 0.0)),
    ),
    "table_out_of_level_more": Case(
        "momentum",
        "flyer_testbed",
        words.FORCE,
        motion=Motion(force_W=(0.0, 19 * G * 2e-3, 0.0)),
    ),
    "firing_forgotten": Case(
        "momentum", "arms_flight", words.FORCE, motion=Motion(firing=Firing(5.0, np.array(FIRED)))
    ),
    "burn_forgotten_exact": Case(
        "momentum",
        "arms_exact",
        words.FORCE,
        motion=Motion(firing=Firing(4.0, np.array(FIRED), 2.0)),
    ),
    "firing_and_tumble": Case(
        "momentum",
        "tumbling_flight",
        words.FORCE,
        motion=Motion(firing=Firing(5.0, np.array(FIRED))),
    ),
}


def _without_noise(*names: str) -> Motion:
    """Return true sensors of which the named ones have no errors."""
    perfect = {"attitude": AttitudeSensor, "position": VectorSensor}
    return Motion(
        suite=lambda suite: replace(suite, **{n: perfect[n](suite[n].rate) for n in names})
    )


def _coloured(source: str, sensors: str, rho: float) -> Case:
    names = ("attitude", "position")
    return Case(
        "noise",
        source,
        r"white|correlat|colour|color",
        noise.coloured(sensors, rho, *names),
        motion=_without_noise(*names),
    )


NOISES = {
    "noise_x5": Case("noise", "arms_flight", words.NOISE, motion=Motion(suite=noise.noisier(5.0))),
    "noise_x5_testbed": Case(
        "noise", "flyer_testbed", words.NOISE, motion=Motion(suite=noise.noisier(5.0))
    ),
    "noise_x5_position": Case(
        "noise", "wheels_servicer", words.NOISE, motion=Motion(suite=noise.noisier(5.0, "position"))
    ),
    "noise_x5_attitude": Case(
        "noise", "arms_flight", words.NOISE, motion=Motion(suite=noise.noisier(5.0, "attitude"))
    ),
    "coloured_0.5": _coloured("arms_flight", "flight", 0.5),
    "coloured_0.9": _coloured("arms_flight", "flight", 0.9),
    "coloured_0.9_testbed": _coloured("flyer_testbed", "testbed", 0.9),
    "gyro_stuck": Case(
        "noise", "arms_flight", r"gyro|angular velocity", noise.frozen("gyro", 4.0, 1)
    ),
    "position_stuck": Case(
        "noise", "flyer_testbed", r"position|stuck|repeat", noise.frozen("position", 5.0, 2)
    ),
    "position_stuck_all": Case(
        "noise", "arms_flight", r"position|stuck|repeat", noise.frozen("position", 5.0)
    ),
    "encoder_stuck": Case(
        "noise", "arms_flight", r"encoder|joint|stuck", noise.frozen("encoders", 4.0, 1)
    ),
    "gyro_scaled": Case(
        "noise", "tumbling_flight", r"gyro|angular velocity", spoil.scaled("gyro", 1.01)
    ),
    "gyro_scaled_flyer": Case(
        "noise", "flyer_testbed", r"gyro|angular velocity", spoil.scaled("gyro", 1.01)
    ),
    "gyro_biased": Case(
        "noise", "arms_flight", r"gyro|bias", spoil.values_of("gyro", lambda w: w + 1e-3)
    ),
    "position_rounded": Case(
        "noise",
        "arms_flight",
        r"noise|round|resol|white|position",
        columns=spoil.rounded(2, "x", "y", "z"),
    ),
    "attitude_spikes": Case(
        "noise", "arms_flight", r"spike|attitude", noise.spiked("flight", "attitude")
    ),
}
