"""Logs of simulated hardware are identified by the command, within their intervals."""

import pytest
from scipy.special import chdtrc
from worlds.hardware_draws import floor, identified, pushed, valves


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "declared"), [(1, True), (2, False), (4, True), (5, False)])
def test_a_platform_that_only_valves_move_is_identified(tmp_path, seed, declared):
    """In space or on a floor; one valve dead, thrust late, and nothing else changes momentum."""
    found = identified(valves(seed, tmp_path, declared=declared), "--momentum", "unknown")
    assert found["code"] in (0, 3)
    assert found["named"]
    assert not found["changes"]
    assert found["known"] >= 3 or (found["code"] == 3 and not declared)
    assert not found["worst"] >= 3


@pytest.mark.slow
def test_weakly_known_inertia_does_not_move_the_rest(tmp_path):
    """The samples know the inertia to 70 % of a size, and more than 3 σ from where it is held."""
    known = "--momentum", "unknown", "--known-bodies", "exact"
    found = identified(pushed(11, tmp_path), *known)
    assert found["code"] in (0, 3)
    assert chdtrc(found["known"], found["nees"]) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("logs", [1, 3])
def test_an_arm_on_a_noisy_floor_is_seen_well_enough_at_5_Hz(tmp_path, logs):
    """With gaps, noise of three times the declared one, and zeros of the joints that are off."""
    found = identified(floor(6, tmp_path, logs=logs), "--momentum", "unknown")
    assert found["code"] == 0
    assert found["known"] == 4
    assert found["worst"] < 3


@pytest.mark.slow
def test_who_moves_the_base_by_hand_fails_a_check(tmp_path):
    """By 0.3 m within a second: the momentum changes by more than the floor can change it."""
    found = identified(floor(5, tmp_path, step=0.3), "--momentum", "unknown")
    assert found["code"] == 4
    failed = [line for line in found["text"].splitlines() if line.startswith("failed check")]
    assert any("changes of the momentum" in line for line in failed)
