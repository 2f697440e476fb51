"""The check that nothing changes the angular momentum between blocks that the fit does not have.

A part of the base on a spring, a liquid or wheels that are not in the log take momentum from the
bodies of the model and give it back. Noise of a sensor is of this sensor alone; momentum moves
attitude, rates and positions together. So for once L may change at the end of each block, whose
length is h, by as much as a white torque of the intensity q leaves in this time:

    L(t + h) = L(t) + u,    u ~ N(0, q² h).

The evidence says whether q is zero. The fit stays linear where it is: this is one sweep more.

Source: Kass and Raftery 1995, Bayes factors (2 ln B > 6 is strong evidence).
"""

from dataclasses import replace

import numpy as np

from cpid_drake.estimation.fit import Fit
from cpid_drake.estimation.likelihood.constants import TORQUE
from cpid_drake.estimation.likelihood.forces import SHORTEST_PIECE
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.noise_evidence import NoiseEvidence
from cpid_drake.identification.checks import Check
from cpid_drake.identification.exact_check import STRONG
from cpid_drake.sensors.error_kinds import KINDS

TRIED = 0.03
"""q that is tried, as a share of a white torque of plausible size in each of its pieces. A larger
torque gains more with it."""


def torque_gain(fit: Fit) -> float:
    """Return by how much −2 log(evidence) of a log falls, at most, if a white torque acts on it.

    It is zero where the pulls of the closed ends say that it is little.
    """
    # q = share · σ_τ √h, with the plausible torque σ_τ in each piece of the length h [N·m·√s]
    q = TRIED * KINDS[TORQUE].plausible(fit.model.tree) * SHORTEST_PIECE**0.5
    gains = [0.0]
    for log, rolled in zip(fit.logs, fit.rolled, strict=True):
        is_exact = fit.model.of_log(log.name).suite.unstated == "exact"
        entries = 3 if fit.model.tree.normal_B is None else 1
        if not _is_hidden(log, q, entries if is_exact else 0):
            evidence = NoiseEvidence(fit.model, log, rolled, fit.values)
            pushed = replace(evidence, log=_pushed(log, q))
            gains.append(evidence(log.processes) - pushed(log.processes))
    return max(gains)


def torque_check(gain: float) -> Check:
    """Return the check that a white torque gains no evidence; see `torque_gain`."""
    sentence = (
        "a torque that is not modelled changes the momentum again and again: a part that swings, a "
        "liquid, wheels or cables may; hold it fast, log it, or state its noise as torque_noise"
    )
    return Check.of("changing torque", sentence, gain, STRONG)


def _is_hidden(log: LogState, q: float, entries: int) -> bool:
    """Return whether a white torque gains little, by the pulls λ of the closed ends alone.

    These are half the slopes of χ² by changes. With b = q √h λ of all ends and the information H
    that samples have of all u / (q √h), the gain is

        bᵀ (H + 1)⁻¹ b − log det(H + 1) ≤ |b|².

    Beside forces that are unknowns, H is small but in few directions. If all else is exact, H is
    the mean of b bᵀ, and large in all: then |b|² is to be more than one an entry, too.

    Args:
        log: the log.
        q: of the torque [N·m·√s].
        entries: of L at each end, if all else is exact; else 0.

    """
    # |b|² = Σ q² h |λ_L|²
    pulls = [log.step(k) * np.sum(link.pull[6:9] ** 2) for k, link in enumerate(log.links)]
    return q**2 * float(np.sum(pulls)) <= max(STRONG, entries * len(pulls))


def _pushed(log: LogState, q: float) -> LogState:
    """Return a log whose L changes by a white torque [N·m·√s] at the ends of its blocks."""
    L = np.repeat([0.0, 0.0, q, 0.0], 3)  # of attitude, centre of mass, L and v
    links = (replace(link, push=log.step(k) ** 0.5 * L) for k, link in enumerate(log.links))
    return log.with_links(links)
