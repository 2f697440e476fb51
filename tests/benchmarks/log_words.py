"""Regular expressions, for text in lower case, that tell whether a message names a cause."""

import re

POSITION_UNIT = (
    r"position.{0,60}(unit|millimet|centimet|feet|inch|factor)"
    r"|(millimet|centimet|unit).{0,60}position"
)
JOINT_UNIT = r"degree"
RATE_UNIT = r"degree|rpm|unit.{0,40}(rate|velocity)|rate.{0,60}(unit|factor)"
TIME_UNIT = r"(millisecond|nanosecond|seconds|unit).{0,60}time|time.{0,60}(millisec|nanosec|unit)"
POINT = r"point|origin of|another body"
AXES = r"axes|frame|convention|quaternion|rotated|expressed in|world|mirror|left-handed"
MODEL = r"model|mass of the (base|spacecraft|known)|known bodies|link"
PAYLOAD = r"payload|held|another body|load|mass that the model|model"
MOMENTUM = r"momentum"
FORCE = r"force|thruster|drift|gravity|push"
CLOCK = r"late|delay|clock|time stamp|timestamp|shifted in time|\bearly\b|earlier|synchron"
JOINT = r"joint|encoder"
NOISE = r"noise (is|seems|of).{0,60}(larger|more|times)|larger noise|noisier"

CAUSES = (
    r"unit|millimet|centimet|\bfeet|degree",
    r"frame|axes|quaternion|expressed in|world",
    r"sign\b",
    r"clock|late\b|early\b|delay",
    r"spacecraft (differs|is not)|the spacecraft,|model|mass of|payload",
    r"force|thruster",
    r"momentum (is|was|of)",
    r"noise (is|was|of)|larger noise",
)
"""Classes of causes."""

MOST_CAUSES = 2
"""Number of classes in one sentence above which the sentence names no cause: it lists them all."""


def names_cause(text: str, words: str) -> bool:
    """Return whether a sentence of a text names a cause, among few others.

    Args:
        text: messages in lower case.
        words: regular expression of the cause.

    """
    for sentence in re.split(r"\n|; |\. |', '", text):
        listed = sum(bool(re.search(cause, sentence)) for cause in CAUSES)
        if listed <= MOST_CAUSES and re.search(words, sentence):
            return True
    return False
