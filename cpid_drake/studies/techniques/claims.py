"""The claims of Ning et al. 2016 about other techniques, each with a verdict from the numbers."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cpid_drake.studies.techniques.comparison import ONE_JOINT, Comparison
from cpid_drake.studies.techniques.records import FIT

UPHELD, REFUTED, QUALIFIED, OPEN = "upheld", "refuted", "qualified", "not run"
"""The verdicts; the last one if a number is missing."""

EQUAL = 1.5
"""Factor below which two RMS errors of some twenty trials are equal."""

SLOW, FAST = "paper", "exciting_motion"
"""The motions of the claims: the paper's, and one that is chosen to excite."""


@dataclass(frozen=True)
class Claim:
    """A claim.

    Attributes:
        text: what the paper says.
        quantity: what is compared.
        papers: the paper's value, in words.
        ours: function that returns our values by name.
        verdict: function of these values that returns a verdict; it is asked only if all are
            numbers.

    """

    text: str
    quantity: str
    papers: str
    ours: Callable[[Comparison], dict[str, float]]
    verdict: Callable[[dict[str, float]], str]


def judge(claim: Claim, found: Comparison) -> tuple[dict[str, float], str]:
    """Return our values and the verdict."""
    values = claim.ours(found)
    known = all(np.isfinite(value) for value in values.values())
    return values, claim.verdict(values) if known else OPEN


def _errors(technique: str, suite: str = "flight") -> Callable[[Comparison], dict[str, float]]:
    """Return the errors of a technique and of the trajectory fit, on both motions."""

    def ours(found: Comparison) -> dict[str, float]:
        return {
            f"{label}, {motion}": found.error(name, motion, suite)
            for motion in (SLOW, FAST)
            for label, name in (("it", technique), ("momentum", FIT))
        }

    return ours


def _is_worse(values: dict[str, float]) -> str:
    """Return whether the technique is worse than momentum on both motions."""
    worse = [
        values[f"it, {motion}"] > EQUAL * values[f"momentum, {motion}"] for motion in (SLOW, FAST)
    ]
    return UPHELD if all(worse) else QUALIFIED if any(worse) else REFUTED


CLAIMS = (
    Claim(
        "Traditional techniques need 30 s, this one 10 s.",
        "RMS error of one joint after another, and of twelve joints at a time, in 10 s each",
        "30 s against 10 s",
        lambda found: {
            "one joint": found.error(FIT, ONE_JOINT, "flight"),
            "twelve joints": found.error(FIT, SLOW, "flight"),
            "seconds": found.durations.get(ONE_JOINT, np.nan),
        },
        lambda v: (
            REFUTED
            if v["one joint"] <= EQUAL * v["twelve joints"] and v["seconds"] <= 10.5
            else UPHELD
        ),
    ),
    Claim(
        "A two-body model that turns in a plane has shortcomings.",
        "error of the planar relations with exact data (target without symmetry), and how many "
        "parameters three axes tell",
        "three runs for all parameters",
        lambda found: {
            "three axes": found.number("planar", "generic, three axes"),
            "six axes": found.number("planar", "generic, six axes"),
            "parameters": found.number("planar", "generic, three axes, known"),
        },
        lambda v: UPHELD if v["parameters"] < 10 and v["six axes"] > 0.01 else REFUTED,
    ),
    Claim(
        "One identification tells all ten parameters.",
        "error of the paper's rows with exact data",
        "ten",
        lambda found: {"error": getattr(found.score("eq18", SLOW, "flight"), "exact", np.nan)},
        lambda v: UPHELD if v["error"] < 1e-6 else REFUTED,
    ),
    Claim(
        "Accelerations are difficult to measure.",
        "RMS error by accelerations: naive, with accelerometer, in relative form; and by momentum",
        "not given",
        lambda found: {
            name: found.error(technique, motion, "flight")
            for motion in (SLOW, FAST)
            for name, technique in (
                (f"naive, {motion}", "accelerations_naive"),
                (f"accelerometer, {motion}", "accelerometer"),
                (f"relative, {motion}", "accelerations"),
                (f"momentum, {motion}", FIT),
            )
        },
        lambda v: (
            REFUTED
            if v[f"accelerometer, {SLOW}"] < 10 * v[f"momentum, {SLOW}"]
            else QUALIFIED
            if v[f"relative, {SLOW}"] < 10 * v[f"momentum, {SLOW}"]
            else UPHELD
        ),
    ),
    Claim(
        "A wrist sensor has large noise.",
        "RMS error with a perfectly calibrated wrist sensor, and by momentum",
        "not given",
        _errors("wrist 0 % perfect"),
        _is_worse,
    ),
    Claim(
        "A wrist sensor is less accurate (with a calibration of 0.5 %, which is estimated).",
        "RMS error with the wrist sensor, and by momentum",
        "not given",
        _errors("wrist 0.5 % estimated"),
        _is_worse,
    ),
    Claim(
        "A wrist sensor is less accurate if the momentum techniques have ordinary sensors.",
        "RMS error with a wrist sensor of 0.1 % (estimated), and by momentum, with “servicer”",
        "not given",
        _errors("wrist 0.1 % estimated", "servicer"),
        _is_worse,
    ),
    Claim(
        "Neural networks are at the research stage.",
        "median error of a network in its range, the same with joints 0.02 rad elsewhere, and the "
        "mass that it tells of 600 kg",
        "not given",
        lambda found: {
            "in range": found.number(f"network {SLOW}", "median error"),
            "joints elsewhere": found.number(
                f"network {SLOW}", "median error, joints 0.02 rad elsewhere"
            ),
            "momentum": found.error(FIT, SLOW, "flight"),
            "mass [kg]": found.number(f"network {SLOW}", "mass told of 600 kg"),
        },
        lambda v: (
            UPHELD
            if v["in range"] > EQUAL * v["momentum"] or v["joints elsewhere"] > 3 * v["in range"]
            else REFUTED
        ),
    ),
    Claim(
        "Adaptive control is difficult to realize.",
        "error of the parameters after 10 and 30 s of Slotine–Li control, after 1 s of composite",
        "not given",
        lambda found: {
            "10 s": found.number(f"Slotine-Li {FAST}", "error after 10 s"),
            "30 s": found.number(f"Slotine-Li {FAST}", "error after 30 s"),
            "30 s, half cosine": found.number(f"Slotine-Li {SLOW}", "error after 30 s"),
            "composite, 1 s": found.number(f"composite {FAST}", "error after 1 s"),
        },
        lambda v: (
            QUALIFIED
            if v["30 s"] < 0.01 < v["30 s, half cosine"]
            else UPHELD
            if v["30 s"] >= 0.01
            else REFUTED
        ),
    ),
    Claim(
        "The base must move to be identified by momentum.",
        "RMS error and largest turn of the base with both arms, and of one arm that moves freely",
        "not said, assumed",
        lambda found: {
            "both arms": found.number("reactionless both arms", "error"),
            "turn [°]": found.number("reactionless both arms", "turn"),
            "free": found.number("reactionless free", "error"),
            "turn, free [°]": found.number("reactionless free", "turn"),
        },
        lambda v: REFUTED if v["both arms"] < 1e-3 and v["turn [°]"] < 0.1 else UPHELD,
    ),
    Claim(
        "The computing time is short.",
        "seconds for an estimate after smoothing: the paper's rows, relative rows, wrist sensor",
        "can be ignored",
        lambda found: {
            name: getattr(found.score(name, SLOW, "flight"), "seconds", np.nan)
            for name in ("eq18", "relative", "wrist 0 % perfect")
        },
        lambda v: QUALIFIED if v["wrist 0 % perfect"] < 10 * v["eq18"] else UPHELD,
    ),
)
"""The claims. That other techniques are as fast qualifies the last one as an advantage."""
