"""The check that nothing changes the angular momentum between blocks that the fit does not have.

A part of the base on a spring, a liquid or wheels that are not in the log take momentum from the
bodies of the model and give it back. Noise of a sensor is of this sensor alone; momentum moves
attitude, rates and positions together. So for once L may change at the end of each block, whose
length is h, by as much as a white torque of the intensity q leaves in this time:

    L(t + h) = L(t) + u,    u ~ N(0, q² h).

The evidence says whether q is zero: its mean over some q. The fit stays linear where it is, so each
q is one sweep more. Online, where blocks are gone, each change says for itself what it says of q;
see `estimation.white_torque`.

Source: Kass and Raftery 1995, Bayes factors (2 ln B > 6 is strong evidence).
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from cpid_drake.estimation.fit import Fit
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.noise_evidence import NoiseEvidence
from cpid_drake.estimation.white_torque import gain_of, intensities
from cpid_drake.identification.checks import Check
from cpid_drake.identification.exact_check import STRONG


def torque_gains(fit: Fit) -> dict[str, float]:
    """Return by how much −2 log(evidence) of each log falls if a white torque acts on it.

    Torques of which the pulls of the closed ends say that they are little gain nothing.
    """
    tried, gains = intensities(fit.model.tree), {}
    for log, rolled in zip(fit.logs, fit.rolled, strict=True):
        evidence = NoiseEvidence(fit.model, log, rolled, fit.values)
        pushed = [replace(evidence, log=_pushed(log, q)) for q in tried if not _is_hidden(log, q)]
        without = evidence(log.noise.processes) if pushed else 0.0
        own = [without - each(log.noise.processes) for each in pushed]
        own += [0.0] * (len(tried) - len(own))
        gains[log.name] = gain_of(np.array(own))
    return gains


def torque_check(gains: Mapping[str, float]) -> Check:
    """Return the check that a white torque gains no evidence in any log; see `torque_gains`."""
    sentence = (
        "a torque that is not modelled changes the momentum again and again: a part that swings, a "
        "liquid, wheels or cables may; hold it fast, log it, or state its noise as torque_noise"
    )
    return Check.of("changing torque", sentence, max(0.0, *gains.values()), STRONG)


def _is_hidden(log: LogState, q: float) -> bool:
    """Return whether a white torque gains little, by the pulls λ of the closed ends alone.

    These are half the slopes of χ² by changes. With b = q √h λ of all ends and the information H
    that samples have of all u / (q √h), the gain is

        bᵀ (H + 1)⁻¹ b − log det(H + 1) ≤ |b|².
    """
    # |b|² = Σ q² h |λ_L|²
    pulls = [log.interval(k) * np.sum(link.pull[6:9] ** 2) for k, link in enumerate(log.links)]
    return q**2 * float(np.sum(pulls)) <= STRONG


def _pushed(log: LogState, q: float) -> LogState:
    """Return a log whose L changes by a white torque [N·m·√s] at the ends of its blocks."""
    L = np.repeat([0.0, 0.0, q, 0.0], 3)  # of attitude, centre of mass, L and v
    links = (replace(link, push=log.interval(k) ** 0.5 * L) for k, link in enumerate(log.links))
    return log.with_links(links)
