"""Momentum needs no model of the servos, and rollouts do: the page about MuJoCo and SciPy."""

import re

import pytest

pytest.importorskip("mujoco", reason="needs the package mujoco")

from worlds.rollouts import OFF, PAGE, ROWS, compared

PRINTED = re.findall(
    r"^\| (.+?) \| (.+?) \| ([\d.]+) ± ([\d.]+) \| ([\d.]+) σ \| (.+?) \|$",
    PAGE.read_text(encoding="utf-8"),
    re.M,
)


def test_the_page_has_all_ways_with_both_servos():
    assert [row[1] for row in PRINTED] == 2 * list(ROWS)


@pytest.mark.slow
@pytest.mark.parametrize("gain", [1.0, 1.0 + OFF])
def test_the_page_shows_what_the_script_finds(gain):
    """The mass to a tenth of its σ; a wrong servo model hurts the rollouts alone."""
    found = compared(gain, seed=1)
    printed = PRINTED[: len(ROWS)] if gain == 1.0 else PRINTED[len(ROWS) :]
    for _, name, mass, sigma, worst, says in printed:
        answer = found[name]
        assert answer.parameters[0] == pytest.approx(float(mass), abs=0.1 * float(sigma)), name
        assert answer.worst == pytest.approx(float(worst), abs=0.2, rel=0.1), name
        assert says == answer.says, name
    for name in ROWS:
        is_wrong = gain != 1.0 and name == "MuJoCo rollouts"
        assert (found[name].worst > 20) == is_wrong, name
        assert is_wrong or found[name].worst < 4, name
