"""Words about estimated errors: numbers as precise as their intervals."""

from types import SimpleNamespace

import numpy as np

from cpid_drake.identification.effects import EffectEstimate
from cpid_drake.identification.result_files import EffectRecord
from cpid_drake.report.sections.effects import effects_section


def test_rounding_errors_are_shown_as_zero():
    """In words and in the report's table, whose embedded number stays as it is."""
    effect = EffectEstimate(
        "encoders.zero", "mrad", np.array([-4.6e-20, 10.4, -2e-3]), np.array([2.0, 0.4, 0.5]), 2.0
    )
    assert "(0 ± 3.9, 10.4 ± 0.78, -0.002 ± 0.98) mrad" in effect.describe()
    numbers = effect.value, effect.sigma, effect.prior_sigma
    record = EffectRecord(effect.name, effect.unit, *numbers, effect.describe())
    section = effects_section(SimpleNamespace(effects=(record,)))
    cells = [row[1] for row in section.tables[0].rows]
    assert [cell.text for cell in cells] == ["0", "10.4", "-0.002"]
    assert cells[0].value == -4.6e-20
