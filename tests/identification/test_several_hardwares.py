"""Logs of one target whose sensors are not the same: calibrated anew, or of another unit."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from sensing_cases import Sines, coarse_suite, measured, nees, sigmas

from cpid_drake import InputError, identify
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.files.dumping import dump_yaml
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro, JointSensor

SCALE, ZERO = 3e-3, 2e-3
"""σ of the true errors of a hardware: of the scale of its gyro, and of its joints' zeros [rad]."""

DURATION = 5.0
HARDWARE = {"a": 0, "b": 0, "c": 1}
"""Number of the true hardware of each log."""


def declared(**changes):
    """Return sensors whose file states the σ of the true errors; other errors are exact."""
    gyro = Gyro(20.0, 0.005, 1.0, 0.1, scale_ppm=1e6 * SCALE)
    encoders = JointSensor(20.0, 1e-5, zero_mrad=1e3 * ZERO)
    return coarse_suite(**{"gyro": gyro, "encoders": encoders} | changes)


@pytest.fixture(scope="module")
def logs(craft, skewed_target):
    """Return a function (seed) -> three logs, the third with other errors than the first two."""

    def make(seed):
        rng, found = np.random.default_rng(seed), {}
        scales, zeros = rng.normal(0, SCALE, (2, 3)), rng.normal(0, ZERO, (2, 4))
        for k, (name, own) in enumerate(HARDWARE.items()):
            motion = Sines.drawn(4, 10 * seed + k, DURATION, 0.6)
            exact = measured(craft, motion, skewed_target, coarse_suite())
            log = add_noise(coarse_suite(), exact, seed=10 * seed + k)
            gyro, encoders = log.gyro, log.encoders
            found[name] = log.updated(
                {
                    "gyro": replace(gyro, value=gyro.value * (1 + scales[own])),
                    "encoders": replace(encoders, value=encoders.value + zeros[own]),
                }
            )
        return found

    return make


def of_two():
    """Return the sensors of each log: two logs with the same, and one with others."""
    first, second = declared(), declared()
    return {"a": first, "b": first, "c": second}


SEEDS = range(4)


@pytest.fixture(scope="module")
def found(craft, logs):
    """The estimates of several draws."""
    return [identify(craft, logs(k), sensors=of_two(), momentum="zero") for k in SEEDS]


class TestTwoHardwares:
    @pytest.mark.slow
    def test_intervals_hold_and_the_logs_agree(self, found, skewed_target):
        assert all(each.passed for each in found)
        total = sum(nees(each, skewed_target) for each in found)
        assert chi2.isf(0.999, 10 * len(found)) < total < chi2.isf(1e-3, 10 * len(found))
        inside = [
            (each.intervals[:, 0] < skewed_target.to_vector())
            & (skewed_target.to_vector() < each.intervals[:, 1])
            for each in found
        ]
        assert np.mean(inside) > 0.85  # of 95 %; of four draws, entries are correlated
        agreement = sum(each.check("agreement").statistic for each in found)
        assert agreement < chi2.isf(1e-3, 20 * len(found))

    @pytest.mark.parametrize(
        "seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in SEEDS[1:])]
    )
    def test_as_one_hardware_they_contradict_each_other(self, craft, logs, seed):
        forced = identify(craft, logs(seed), sensors=declared(), momentum="zero")
        assert not forced.check("agreement").passed

    @pytest.mark.slow
    def test_the_errors_of_each_are_found(self, found):
        far = []
        for seed, each in zip(SEEDS, found, strict=True):
            rng = np.random.default_rng(seed)
            truth = {"gyro.scale": 1e6 * rng.normal(0, SCALE, (2, 3))}
            truth["encoders.zero"] = 1e3 * rng.normal(0, ZERO, (2, 4))
            effects = [effect for effect in each.effects if effect.name in truth]
            assert [effect.hardware for effect in effects] == ["a", "a", "c", "c"]
            for effect in effects:
                error = effect.value - truth[effect.name][HARDWARE[effect.hardware]]
                far.extend(error / effect.sigma)
                if effect.name == "gyro.scale":
                    assert np.all(effect.sigma < 0.2 * effect.prior_sigma)
        assert np.sum(np.square(far)) < chi2.isf(1e-3, len(far))

    @pytest.mark.slow
    def test_rows_of_the_error_budget_name_the_hardware(self, found):
        names = " ".join(row.name for row in found[0].budget)
        assert "zero of shoulder with the sensors of a" in names
        assert "zero of shoulder with the sensors of c" in names
        assert "sensors of b" not in names

    def test_each_may_have_other_sensors(self, craft, logs, skewed_target):
        """One without positions and with a poor attitude, of which most is not stated."""
        poor = AttitudeSensor(5.0, 50.0, 50.0)
        other = replace(declared(attitude=poor, position=None), unstated=None)
        sensors = of_two() | {"c": other}
        found = identify(craft, logs(0), sensors=sensors, known_bodies=BodyUncertainty())
        assert found.passed
        assert nees(found, skewed_target) < chi2.isf(1e-3, 10)
        compliances = [each for each in found.effects if each.name == "compliance"]
        assert [each.hardware for each in compliances] == ["c"]
        forces = {each.log for each in found.effects if each.name == "torque"}
        assert forces == {"c"}


class TestOneHardware:
    def test_its_errors_are_shared(self, craft, logs):
        """Two logs know better what the motion shows of them, and so the mass."""
        pair = {name: logs(0)[name] for name in ("a", "b")}
        shared = identify(craft, pair, sensors=declared(), momentum="zero")
        separate = {name: declared() for name in pair}
        apart = identify(craft, pair, sensors=separate, momentum="zero")
        assert sigmas(shared)[0] < sigmas(apart)[0]
        for name, seen in (("gyro.scale", slice(3)), ("encoders.zero", slice(3))):
            [both] = [each for each in shared.effects if each.name == name]
            own = [each for each in apart.effects if each.name == name]
            assert len(own) == 2
            assert all(np.all(both.sigma[seen] < each.sigma[seen]) for each in own)
        assert both.sigma[3] == pytest.approx(1e3 * ZERO, rel=1e-3)
        for each in own:
            assert each.sigma[3] == pytest.approx(1e3 * ZERO / np.sqrt(2), rel=1e-2)

    @pytest.mark.slow
    def test_one_may_be_said_in_several_ways(self, craft, logs, tmp_path):
        """By one suite for all logs, the same for each, or one file by any path."""
        pair, path = {name: logs(0)[name] for name in ("a", "b")}, tmp_path / "sensors.yaml"
        suite = declared()
        path.write_text(dump_yaml(suite))
        one = identify(craft, pair, sensors=suite, momentum="zero")
        each_path = {"a": path, "b": f"{tmp_path}/./sensors.yaml"}
        for sensors in (dict.fromkeys(pair, suite), path, each_path):
            found = identify(craft, pair, sensors=sensors, momentum="zero")
            np.testing.assert_array_equal(found.covariance, one.covariance)
            np.testing.assert_array_equal(found.parameters, one.parameters)

    def test_a_single_log_may_be_named(self, craft, logs):
        log, suite = logs(0)["a"], declared()
        one, named = (
            identify(craft, log, sensors=sensors, momentum="zero")
            for sensors in (suite, {"log": suite})
        )
        np.testing.assert_array_equal(named.parameters, one.parameters)


class TestBodies:
    @pytest.mark.slow
    def test_they_are_exact_if_all_sensors_say_so(self, craft, logs):
        pair = {name: logs(0)[name] for name in ("a", "c")}
        both = {"a": declared(), "c": declared()}
        mixed = both | {"c": replace(declared(), unstated=None)}
        exact, open_bodies, stated = (
            identify(craft, pair, sensors=sensors, known_bodies=bodies, momentum="zero")
            for sensors, bodies in ((both, None), (mixed, None), (mixed, BodyUncertainty()))
        )
        assert (exact.given, open_bodies.given, stated.given) == (
            ("spacecraft model",),
            (),
            ("spacecraft model",),
        )
        assert np.all(sigmas(open_bodies) > sigmas(exact))
        assert sigmas(open_bodies)[0] > 10 * sigmas(exact)[0]

    @pytest.mark.slow
    def test_all_logs_have_the_same(self, craft, logs):
        """Rows of the budget name a body once, however many hardwares there are."""
        suites = {name: replace(declared(), unstated=None) for name in HARDWARE}
        found = identify(craft, logs(0), sensors=suites, momentum="zero")
        bodies = [row.name for row in found.budget if row.name.startswith("mass of ")]
        assert bodies
        assert not any("sensors of" in name for name in bodies)
        assert len(set(bodies)) == len(bodies)


def test_rows_are_weighed_by_the_sensors_of_their_log(craft, logs):
    pair = {name: logs(0)[name] for name in ("a", "c")}
    sensors = {"a": declared(), "c": declared(gyro=Gyro(20.0, 0.5, 1.0, 0.1))}
    found = identify(craft, pair, sensors=sensors, estimator="least_squares")
    for name, log in pair.items():
        alone = identify(craft, log, sensors=sensors[name], estimator="least_squares")
        np.testing.assert_allclose(found.logs[name].parameters, alone.parameters, rtol=1e-6)


@pytest.mark.parametrize(
    ("sensors", "message"),
    [
        ({"d": declared()}, "there is no log 'd'; choose from a, b, c"),
        ({"a": declared(), "c": declared()}, "log 'b' has none; give"),
        ({}, "log 'a' has none"),
        ({"a": None, "b": declared(), "c": declared()}, "log 'a' has none"),
    ],
)
def test_sensors_that_do_not_fit_the_logs_are_refused(craft, logs, sensors, message):
    with pytest.raises(InputError, match=message):
        identify(craft, logs(0), sensors=sensors)
