"""No convention is blamed for thrusters that fire, in logs from a simulator of another kind."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the package mujoco")

from worlds import hidden_world
from worlds.hidden_world import CRAFTS, Hidden, World, simulate

import cpid_drake as cpid
from cpid_drake.identification.log_conventions import check_as_read


class Firing(World):
    """A world in which thrusters fire for a second along each of the base's axes."""

    force = 0.6
    """Largest force [N], times the strength of the craft."""

    def _act(self, model, data):
        super()._act(model, data)
        axis, second = divmod(int(data.time) - 2, 3)
        is_on = data.time >= 2 and axis < 3 and second == 0
        push = np.eye(3)[axis] * self.force * self.craft.strong if is_on else np.zeros(3)
        R_WB = data.xmat[self.base].reshape(3, 3)
        data.xfrc_applied[self.base] = [*R_WB @ push, *R_WB @ np.cross(self.point_B, push)]


@pytest.mark.slow
@pytest.mark.parametrize("force", [0.6, 3.0])
@pytest.mark.parametrize("name", CRAFTS)
def test_thrust_that_no_one_logs_is_no_convention(name, force, tmp_path, monkeypatch):
    model = tmp_path / "craft.xml"
    model.write_text(CRAFTS[name].mjcf())
    craft = cpid.Spacecraft(model, base="base", capture_frame="grip")
    monkeypatch.setattr(Firing, "force", force)
    monkeypatch.setattr(hidden_world, "World", Firing)
    log, _ = simulate(CRAFTS[name], Hidden(), 402)
    for part in (log, log.between(0.0, 6.0)):
        assert check_as_read(part, craft).conventions.failures == ()
