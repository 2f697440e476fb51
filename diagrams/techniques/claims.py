"""The claims of Ning et al. 2016 about other techniques, each with a verdict from the numbers."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from techniques.comparison import GENERIC, ONE_JOINT, SUITES, TechniqueComparison
from techniques.experiments import ARMS
from techniques.records import FIT, PLANAR

UPHELD, REFUTED, QUALIFIED, OPEN = "upheld", "refuted", "qualified", "not tested"
"""The verdicts; the last one if there is no number, or one is missing."""

EQUAL = 1.5
"""Factor below which two RMS errors of some twenty trials are equal."""

SLOW, FAST = "paper", "exciting_motion"
"""The motions of the claims: the paper's, and one that is chosen to excite."""

PAPERS, RELATIVE, WRIST = (
    "momentum, the paper's rows",
    "accelerations, relative",
    "wrist sensor, perfect",
)

Place = tuple[str, ...]
"""Arguments of `TechniqueComparison.number`: technique, motion; also quantity, sensors, target."""


@dataclass(frozen=True)
class Claim:
    """A claim.

    Attributes:
        text: what the paper says.
        papers: the paper's value, in words.
        numbers: where ours are, by what they are.
        verdict: function of their values in this order that returns a verdict; it is asked only if
            there are some, and all are known.

    """

    text: str
    papers: str
    numbers: Mapping[str, Place]
    verdict: Callable[..., str]


def judge(claim: Claim, found: TechniqueComparison) -> tuple[dict[str, float], str]:
    """Return our values and the verdict."""
    values = {name: found.number(*place) for name, place in claim.numbers.items()}
    known = values and all(np.isfinite(value) for value in values.values())
    return values, claim.verdict(*values.values()) if known else OPEN


def _is(upheld: bool, qualified: bool = False) -> str:
    return UPHELD if upheld else QUALIFIED if qualified else REFUTED


def _wrist(text: str, technique: str, sensors: str) -> Claim:
    """Return the claim that a wrist sensor is worse than the trajectory fit, on both motions."""
    numbers = {
        f"{label}, {motion}": (name, motion, "rms", sensors)
        for motion in (SLOW, FAST)
        for label, name in (("wrist sensor", technique), ("momentum", FIT))
    }

    def verdict(slow: float, least_slow: float, fast: float, least_fast: float) -> str:
        worse = slow > EQUAL * least_slow, fast > EQUAL * least_fast
        return _is(all(worse), any(worse))

    return Claim(text, "not given", numbers, verdict)


CLAIMS = (
    Claim(
        "Traditional techniques need 30 s, this one 10 s.",
        "30 s against 10 s",
        {"one joint after another, 10 s": (FIT, ONE_JOINT), "twelve joints, 10 s": (FIT, SLOW)},
        lambda one, twelve: _is(one > EQUAL * twelve),
    ),
    Claim(
        "A two-body model that rotates in a plane has shortcomings.",
        "three runs for all parameters",
        {
            f"{quantity}, exact data": (PLANAR, ONE_JOINT, quantity, SUITES[0], GENERIC)
            for quantity in ("error, six axes", "parameters, three axes")
        },
        lambda error, parameters: _is(parameters < 10 and error > 0.01),
    ),
    Claim(
        "One identification determines all ten parameters.",
        "ten",
        {"error with exact data": (PAPERS, SLOW, "exact")},
        lambda error: _is(error < 1e-6),
    ),
    Claim(
        "Two instants suffice.",
        "two",
        {
            "instants, momentum": (PAPERS, SLOW, "instants"),
            "instants, wrist sensor": (WRIST, SLOW, "instants"),
        },
        lambda momentum, wrist: _is(momentum <= 2),
    ),
    Claim(
        "Any joints may move, and there is no singular configuration.",
        "any",
        {
            f"bound, {joints}": ("momentum, only some joints move", SLOW, f"bound, {joints}")
            for joints in ("capture arm", "its outer half", "its inner half", "other joints")
        }
        | {"bound, all joints": (FIT, SLOW, "bound")},
        lambda arm, outer, inner, other, whole: _is(
            max(arm, outer, inner, other) < EQUAL * whole, max(arm, outer, inner) < 0.05
        ),
    ),
    Claim(
        "Accelerations are difficult to measure.",
        "not given",
        {
            "naive": ("accelerations, naive", SLOW),
            "with accelerometer": ("accelerations, accelerometer", SLOW),
            "relative form": (RELATIVE, SLOW),
            "momentum": (FIT, SLOW),
        },
        lambda naive, measured, relative, momentum: (
            REFUTED if measured < 10 * momentum else _is(relative >= 10 * momentum, True)
        ),
    ),
    _wrist("A wrist sensor has large noise.", WRIST, SUITES[0]),
    _wrist(
        "A wrist sensor is less accurate (calibrated to 0.5 %, which is estimated).",
        "wrist sensor, 0.5 % estimated",
        SUITES[0],
    ),
    _wrist(
        "A wrist sensor is less accurate if the base has ordinary sensors (calibrated to 0.1 %).",
        "wrist sensor, 0.1 % estimated",
        SUITES[1],
    ),
    Claim(
        "Neural networks are at the research stage.",
        "not given",
        {
            "median error in range": ("neural network", SLOW, "median error"),
            "joints 0.02 rad elsewhere": (
                "neural network",
                SLOW,
                "median error, joints 0.02 rad elsewhere",
            ),
            "momentum": (FIT, SLOW),
            "mass found of 600 kg": ("neural network", SLOW, "mass found of 600 kg"),
        },
        lambda inside, other, momentum, mass: _is(inside > EQUAL * momentum or other > 3 * inside),
    ),
    Claim(
        "Adaptive control is difficult to realize.",
        "not given",
        {
            "error after 30 s, half cosine": ("adaptive control", SLOW, "error after 30 s"),
            "error after 30 s": ("adaptive control", FAST, "error after 30 s"),
            "composite, 1 s": ("adaptive control, composite", FAST, "error after 1 s"),
        },
        lambda slow, fast, composite: _is(fast >= 0.01, slow >= 0.01),
    ),
    Claim(
        "The base must move to be identified by momentum.",
        "not said, assumed",
        {
            f"{number}, {arms}": (f"reactionless motion, {arms}", FAST, number)
            for arms in ARMS[1:]
            for number in ("error", "rotation [°]")
        },
        lambda error, rotation, free, rotation_free: _is(error >= 1e-3 or rotation >= 0.1),
    ),
    Claim(
        "The computing time is short.",
        "can be ignored",
        {f"seconds, {name}": (name, SLOW, "seconds") for name in (PAPERS, RELATIVE, WRIST)},
        lambda papers, accelerations, wrist: _is(wrist >= 10 * papers, True),
    ),
    Claim(
        "An unknown momentum costs much computing.",
        "not given",
        {
            "seconds, momentum zero": ("momentum, standard rows", SLOW, "seconds"),
            "seconds, any": ("momentum, standard rows, any momentum", SLOW, "seconds"),
        },
        lambda zero, free: _is(free >= 10 * zero, free > EQUAL * zero),
    ),
    Claim(
        "A simulation with the identified parameters repeats the motion.",
        "0.25 % of attitude, 0.04 % of position (Fig. 7)",
        {name: ("the paper's Table 1, simulated", SLOW, name) for name in ("attitude", "position")},
        lambda attitude, position: _is(position <= 5e-4, attitude <= 3e-3),
    ),
    Claim("The technique was verified on the satellite ETS-VII.", "ETS-VII", {}, lambda: OPEN),
)
"""The claims. That other techniques are as fast qualifies the computing time as an advantage."""
