"""Campaigns: what varies, the same rows however they are computed, and nothing lost."""

import json
import pickle
import re

import numpy as np
import pytest

from cpid_drake import InputError, identify, load_scenario, load_sensors
from cpid_drake.dynamics.momentum import system_momentum
from cpid_drake.logs.log import Log, Samples

pa = pytest.importorskip("pyarrow")
dask = pytest.importorskip("dask")
distributed = pytest.importorskip("distributed")

from cpid_drake.campaign import store  # noqa: E402
from cpid_drake.campaign.campaign_schema import Axis, ModelErrors, load_campaign  # noqa: E402
from cpid_drake.campaign.run import run_campaign  # noqa: E402
from cpid_drake.campaign.statistics import parts_of, statistics_of, verdict  # noqa: E402
from cpid_drake.campaign.trial import (  # noqa: E402
    replayed,
    run_chunk,
    schema_of,
    with_sensor_errors,
)
from cpid_drake.report.pages.campaign_page import campaign_report  # noqa: E402

EXACT = """
scenario: paper
trials: 4
seed: 5
repeated: 0.0
estimators: [standard]
fixed: {simulation.duration: 4.0, identification.period: 0.1, identification.offset: 0.1}
axes:
  target.mass: {uniform: [50, 150]}
  tumble_C: {normal: [[0, 0, 0], [0.01, 0.01, 0.01]]}
"""
"""A campaign of exact samples, whose trials take milliseconds."""

NOISY = EXACT.replace("fixed: {", "fixed: {sensors.explicit: SUITE, ").replace(
    "SUITE",
    "{disturbances: {torque: 0.01, torque_walk: 0.01, acceleration: 1e-4}, "
    "encoders: {rate: 20, sigma: 1e-6}, attitude: {rate: 20}, position: {rate: 20, sigma: 1e-5}}",
)
"""The same with the noise of slow sensors, and forces."""


@pytest.fixture
def plan(tmp_path):
    """Return a function from the text of a campaign to its plan."""

    def load(text: str):
        file = tmp_path / "campaign.yaml"
        file.write_text(text)
        return load_campaign(file)

    return load


@pytest.fixture(scope="module")
def scheduler():
    """The address of a scheduler in this process with one worker, a thread."""
    options = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(processes=False, **options) as cluster:
        yield cluster.scheduler_address


def rows(folder_or_table, plan=None):
    """Return rows as mappings, without the times that they took."""
    tables = [folder_or_table] if plan is None else store.read(folder_or_table, plan)
    found = [row for table in tables for row in table.to_pylist()]
    return [{k: v for k, v in row.items() if not k.endswith("seconds")} for row in found]


# -- the file --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "cause"),
    [
        ("trials:", "trails:", "unknown key 'trails'; did you mean 'trials'?"),
        ("scenario: paper", "scenario: papre", "did you mean 'paper'?"),
        ("trials: 4", "trials: 0", "trials must be greater than or equal to 1"),
        ("[standard]", "[standrad]", "no 'standrad'; did you mean 'standard'?"),
        ("target.mass", "target.mas", "no key 'target.mas'; did you mean 'mass'?"),
        ("uniform: [50, 150]", "uniform: [50, 150], grid: [1]", "not uniform and grid"),
        ("uniform: [50, 150]", "uniform: [150, 50]", "[low, high], with low <= high"),
        ("uniform: [50, 150]", "log_uniform: [0, 50]", "the ends of log_uniform must be > 0"),
        ("uniform: [50, 150]", "normal: [100, -1]", "must not be negative"),
        ("uniform: [50, 150]", "one_of: [heavy]", "target.mass must be a valid number"),
        (
            "simulation.duration",
            "sensors.suite: flihgt, simulation.duration",
            "flihgt: no such file",
        ),
        ("simulation.duration", "errors.delay_ms: {gyr: 1}, simulation.duration", "'gyro'?"),
        ("seed: 5", "seed: 5\nrequirements: {mass: {error: 1 g, probability: 0.9}}", "'1 g'"),
        ("seed: 5", "seed: 5\nengine: drake\n", "known_bodies and errors need engine: propagator"),
    ],
)
def test_a_wrong_campaign_is_refused(plan, old, new, cause):
    text = EXACT.replace(old, new)
    if "drake" in new:
        text = text.replace("fixed: {", "fixed: {known_bodies.mass: 0.01, ")
    with pytest.raises(InputError, match=re.escape(cause)):
        plan(text)


@pytest.mark.parametrize("name", ["estimators", "mission"])
def test_shipped_campaigns_can_be_run(name):
    found = load_campaign(f"package://cpid_drake_models/campaigns/{name}.yaml")
    assert replayed(found, found.total - 1).target_truth().mass > 0


def test_axes_are_drawn_as_they_say(plan):
    text = (
        EXACT
        + "  known_bodies.mass: {grid: [0.0, 0.01]}\n  simulation.duration: {one_of: [1, 2]}\n"
    )
    found = plan(text.replace("target.mass: {uniform", "target.mass: {log_uniform"))
    assert found.total == 8
    values = [found.values(number) for number in range(8)]
    assert [v["known_bodies.mass"] for v in values] == 4 * [0.0] + 4 * [0.01]
    assert {v["simulation.duration"] for v in values} == {1, 2}
    assert values == [found.values(number) for number in range(8)]
    assert len({v["target.mass"] for v in values}) == 8
    rng, axis = np.random.default_rng(0), Axis(log_uniform=np.array([50.0, 150.0]))
    drawn = np.log([axis.draw(rng) for _ in range(4000)])
    low, high = np.log([50, 150])
    assert abs(drawn.mean() - (low + high) / 2) < 4 * (high - low) / np.sqrt(12 * 4000)
    assert abs(drawn.std() / (high - low) * np.sqrt(12) - 1) < 0.05


def test_a_solid_and_a_tumble_become_inertia_and_momentum(plan):
    """A box of 1.2 m, 0.6 m and 0.3 m; its angular momentum before the capture remains."""
    fixed = "fixed: {target.solid: {shape: box, size: [1.2, 0.6, 0.3]}, tumble_C: [0.1, 0.0, 0.0], "
    found = plan(EXACT.replace("fixed: {", fixed).replace("  tumble_C: {normal", "  # {"))
    trial = found.trial({"target.mass": 60.0})
    expected = 5.0 * np.diag([0.6**2 + 0.3**2, 1.2**2 + 0.3**2, 1.2**2 + 0.6**2])
    np.testing.assert_allclose(trial.target_truth().I_TTcm_C, expected)
    scenario = replayed(found, 0)
    craft, truth = scenario.spacecraft.make(), scenario.target_truth()
    motion = scenario.make_joint_motion(craft)
    telemetry = craft.predicted_motion(truth, motion, [0.0, 1.0], scenario.simulation.momentum_W)
    P, L = system_momentum(craft.tree, truth, telemetry)
    plant, context = craft.plant, craft.plant.CreateDefaultContext()
    plant.SetPositionsAndVelocities(context, craft.to_states(telemetry)[0])
    frames = craft.base.body_frame(), craft.capture_frame
    R_BC = plant.CalcRelativeTransform(context, *frames).rotation().matrix()
    L_W = R_BC @ truth.I_TTcm_C @ [0.1, 0.0, 0.0]  # B's axes are W's before the capture
    np.testing.assert_allclose(L[0], L_W, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(L[1], L_W, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(P, 0.0, atol=1e-9)


def test_a_tumble_is_added_to_the_momentum_of_the_scenario(plan):
    """The chaser's own momentum remains when it captures a target that turns."""
    own = [0.3, -0.2, 0.1, 0.5, 0.4, -0.6]
    text = EXACT.replace("  tumble_C: {normal", "  # {")

    def total(fixed: str):
        found = plan(text.replace("fixed: {", f"fixed: {{{fixed}"))
        return np.asarray(replayed(found, 0).simulation.momentum_W)

    both = total(f"simulation.momentum_W: {own}, tumble_C: [0.1, -0.05, 0.02], ")
    of_tumble = total("tumble_C: [0.1, -0.05, 0.02], ")
    assert np.linalg.norm(of_tumble[:3]) > 1.0
    np.testing.assert_allclose(both - of_tumble, own, atol=1e-12)


# -- the rows --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "bodies"),
    [(EXACT, "0.0"), pytest.param(NOISY, "0.01", marks=pytest.mark.slow)],
    ids=["exact", "noisy and uncertain"],
)
def test_the_rows_do_not_depend_on_chunks(plan, text, bodies):
    found = plan(text.replace("fixed: {", f"fixed: {{known_bodies.mass: {bodies}, "))
    whole = rows(run_chunk(found.text, 0, 3))
    parts = [(0, 1), (1, 3)]
    assert whole == [row for part in parts for row in rows(run_chunk(found.text, *part))]
    assert [row["trial"] for row in whole] == [0, 1, 2]
    assert all(row["error"] is None for row in whole)
    error = np.abs([np.subtract(row["estimate"], row["truth"]) for row in whole])
    assert error.max() < 1e-6 if text == EXACT else error[:, 0].min() > 1e-3


def test_a_trial_that_fails_is_a_row_with_its_error(plan):
    """Some of these inertias are no rigid body's; the others are identified."""
    axis = "  target.I_TTcm_C.0.0: {uniform: [0, 40]}\n"
    table = run_chunk(plan(EXACT + axis).text, 0, 4)
    wrong = [value < 20 for value in table["axis target.I_TTcm_C.0.0"].to_pylist()]
    assert any(wrong)
    assert not all(wrong)
    for row, is_wrong in zip(table.to_pylist(), wrong, strict=True):
        assert ("not a rigid body" in (row["error"] or "")) == is_wrong
        assert (row["estimate"] is None) == is_wrong


def test_given_errors_of_the_model_act_on_the_estimate(plan):
    """Masses that are too large by one factor make the target as much too heavy."""
    errors = "fixed: {errors.mass: -0.01, declared.momentum: zero, "
    text = EXACT.replace("fixed: {", errors).replace("  tumble_C: {normal", "  # {")
    [row, *_] = rows(run_chunk(plan(text).text, 0, 1))
    assert row["estimate"][0] / row["truth"][0] == pytest.approx(1 / 0.99, rel=1e-5)


def test_a_late_sensor_has_later_stamps_and_an_encoder_its_zero():
    log = Log(("a",), {n: Samples(np.arange(3.0), np.ones((3, k))) for n, k in SIZES.items()})
    errors = ModelErrors(delay_ms={"gyro": 20.0}, joint_zero_mrad=np.array([2.0]))
    found = with_sensor_errors(log, errors)
    np.testing.assert_allclose(found["gyro"].time, [0.02, 1.02, 2.02])
    np.testing.assert_allclose(found["encoders"].value, 1.002)
    np.testing.assert_allclose(found["encoders"].time, [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(found["gyro"].value, 1.0)


SIZES = {"gyro": 3, "encoders": 1}
"""Sensors and their entries."""


def test_drake_simulates_what_the_propagator_propagates(plan):
    text = EXACT.replace("repeated: 0.0", "repeated: 1.0").replace("trials: 4", "trials: 1")
    text = text.replace("duration: 4.0", "duration: 2.0")
    [row] = run_chunk(plan(text).text, 0, 1).to_pylist()
    assert row["drake_position"] < 1e-8
    assert row["drake_angle"] < 1e-8
    [other] = run_chunk(plan(text + "engine: drake\n").text, 0, 1).to_pylist()
    assert other["truth"] == row["truth"]
    np.testing.assert_allclose(other["estimate"], row["estimate"], rtol=0, atol=1e-3)


# -- the folder ------------------------------------------------------------------------------------


def test_a_campaign_is_continued_and_its_folder_protected(plan, tmp_path, scheduler):
    found, folder = plan(EXACT), tmp_path / "out"
    states = []
    run_campaign(found, folder, scheduler=scheduler, chunk=2, progress=states.append)
    whole = rows(folder, found)
    assert whole == rows(run_chunk(found.text, 0, 4))
    (folder / "trials-000000002-000000003.parquet").unlink()
    (folder / ".cpid-draft-1").mkdir()
    (folder / ".cpid-draft-1/trials").write_text("half")
    with pytest.raises(InputError, match="continue it with --resume"):
        run_campaign(found, folder, scheduler=scheduler)
    elsewhere = tmp_path / "moved" / "campaign.yaml"
    elsewhere.parent.mkdir()
    elsewhere.write_text(EXACT)
    ended = run_campaign(elsewhere, folder, scheduler=scheduler, resume=True, chunk=1)
    assert (ended.new, ended.done) == (2, 4)
    assert rows(folder, found) == whole
    assert not list(folder.glob(".*"))
    with pytest.raises(InputError, match="another campaign"):
        run_campaign(plan(EXACT.replace("seed: 5", "seed: 6")), folder, resume=True)
    cut = folder / "trials-000000000-000000001.parquet"
    cut.write_bytes(cut.read_bytes()[:-20])
    with pytest.raises(InputError, match=r"damaged.*delete it"):
        run_campaign(found, folder, resume=True)


def test_no_scheduler_is_refused(plan, tmp_path):
    with (
        dask.config.set({"distributed.comm.timeouts.connect": "1s"}),
        pytest.raises(InputError, match=r"no scheduler at tcp://127.0.0.1:9"),
    ):
        run_campaign(plan(EXACT), tmp_path / "out", scheduler="tcp://127.0.0.1:9")


def test_a_full_disk_leaves_a_valid_data_set(plan, tmp_path, scheduler):
    """From the second file on, none may be as large as the first."""
    resource, found, folder = pytest.importorskip("resource"), plan(EXACT), tmp_path / "out"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill(state):
        if state.new:
            resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))

    given = {"scheduler": scheduler, "chunk": 1}
    try:
        with pytest.raises(InputError, match=r"trials-.*parquet: cannot write there"):
            run_campaign(found, folder, **given, progress=fill)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert [row["trial"] for row in rows(folder, found)] == [0]
    run_campaign(found, folder, **given, resume=True)
    assert rows(folder, found) == rows(run_chunk(found.text, 0, found.total))


# -- statistics, on errors of known distribution ---------------------------------------------------


@pytest.fixture
def drawn(plan, tmp_path):
    """Return a function that writes a campaign whose errors have a known covariance."""

    def write(count: int, reported: float = 1.0, shift: float = 0.0, requirements: str = ""):
        found, folder = (
            plan(f"{EXACT}{requirements}".replace("trials: 4", f"trials: {count}")),
            tmp_path / "drawn",
        )
        store.open_folder(folder, found, resume=False)
        rng, sigma = np.random.default_rng(8), 1e-3 * np.geomspace(1, 50, 10)
        truth = np.array([100.0, 0.4, 0.1, -0.2, 20.0, 30.0, 25.0, 1.0, -2.0, 0.5])
        table = []
        for number in range(count):
            z = rng.standard_normal(10) + shift
            common = {"trial": number, "point": 0, "estimator": "standard", "passed": True}
            common |= {"axis target.mass": 100.0, "axis tumble_C": "[0.01, 0.0, 0.0]"}
            if number == 3:
                table.append({**common, "error": "too few samples"})
                continue
            table.append(
                common
                | {"truth": truth, "estimate": truth + sigma * z}
                | {"bound": sigma if number % 2 else None}
                | {"sigma": np.sqrt(reported) * sigma, "known": 10, "failed_checks": []}
                | {"inside": (np.abs(z) < 1.96 * np.sqrt(reported)).tolist()}
                | {"nees": float(z @ z / reported)}
            )
        for first in range(0, count, 500):
            part = table[first : first + 500]
            chunk = pa.Table.from_pylist(part, schema_of(found))
            store.write_chunk(folder, found, first, chunk, first + len(part))
        return folder

    return write


@pytest.mark.parametrize(
    "axis",
    [
        Axis(normal=np.array([5.0, 0.5])),
        Axis(normal=np.array([[1.0, 2.0, 3.0], [0.1, 0.1, 0.1]])),
        Axis(normal=np.array([[0.0, 0.0, 0.0], [0.1, 0.2, 0.1]])),
        Axis(uniform=np.array([[10.0, -11.0], [11.0, -10.0]])),
        Axis(uniform=np.array([[-1.0, -2.0], [3.0, 1.0]])),
        Axis(log_uniform=np.array([[1.0, 10.0], [10.0, 1000.0]])),
    ],
)
def test_the_parts_of_an_axis_divide_its_values(axis):
    """Each value is in the part that names it, the first and the last part have what is beyond."""
    names, place = parts_of(axis)
    edges = [tuple(map(float, name.split(" to "))) for name in names]
    rng, counts = np.random.default_rng(0), np.zeros(len(names))
    for value in (axis.draw(rng) for _ in range(2000)):
        k = place(json.dumps(value) if isinstance(value, list) else value)
        size, counts[k] = np.linalg.norm(value), counts[k] + 1
        assert k == 0 or size > 0.995 * edges[k][0]
        assert k == len(names) - 1 or size < 1.005 * edges[k][1]
    assert (counts > 0).all()
    assert counts.max() < 0.5 * counts.sum()


def test_honest_errors_have_ratio_one_and_95_percent_coverage(drawn):
    found = statistics_of(drawn(2000))
    tally = found.by_point[0, "standard"]
    assert (found.done, tally.trials, tally.failed) == (2000, 2000, 1)
    assert tally.problem == "too few samples"
    np.testing.assert_allclose(tally.over_bound(), 1.0, atol=0.07)
    error, bound = tally.beside_bound()  # of the same trials, and the bound is always the same
    np.testing.assert_allclose(error / bound, tally.over_bound(), rtol=1e-12)
    np.testing.assert_allclose(tally.inside / tally.counted, 0.95, atol=0.02)
    low, high = tally.nees_band()
    assert low < tally.nees / tally.freedom < high
    assert tally.verdicts[True, False] < 10  # 2 expected
    assert found.by_axis["target.mass", "100 to 112", "standard"].trials == 2000


def test_overconfidence_and_bias_show(drawn):
    tally = statistics_of(drawn(400, reported=0.25, shift=1.0)).by_point[0, "standard"]
    np.testing.assert_allclose(tally.over_bound(), np.sqrt(2), rtol=0.15)
    assert tally.nees / tally.freedom == pytest.approx(8, rel=0.1)
    assert (tally.inside / tally.counted).max() < 0.75
    assert tally.verdicts[True, False] > 350  # passed, and wrong


@pytest.mark.parametrize(
    ("met", "trials", "probability", "text"),
    [
        (299, 299, 0.99, "met"),  # 0.99^299 < 0.05
        (298, 298, 0.99, "not enough trials"),
        (0, 0, 0.99, "not enough trials"),
        (950, 1000, 0.99, "not met"),
        (985, 1000, 0.99, "not enough trials"),
        (0, 10, 0.5, "not met"),
    ],
)
def test_a_verdict_needs_enough_trials(met, trials, probability, text):
    assert verdict(met, trials, probability)[0] == text


def test_the_report_has_verdicts_tables_and_the_worst_trials(drawn):
    mass, com = "{error: 1 %, probability: 0.9}", "{error: 1e-9, probability: 0.9}"
    folder = drawn(60, requirements=f"requirements: {{mass: {mass}, com: {com}}}\n")
    page = campaign_report(statistics_of(folder), folder)
    page.write_folder(folder)
    assert "RMS error over Cramér-Rao bound, 60 trials" in page.html()
    text = (folder / "requirements.csv").read_text()
    assert "mass ,standard,1 %,90 %,59 of 60" in text
    assert "not met" in text.splitlines()[2]
    assert (folder / "report.html").read_text().count('role="img"') == 3
    worst = (folder / "worst.csv").read_text().splitlines()[1].split(",")
    scenario = load_scenario(folder / worst[-1].split()[-1])
    assert scenario.target.mass > 0


# -- pickling --------------------------------------------------------------------------------------


def test_what_a_worker_needs_can_be_pickled(servicer, paper_scenario, paper_target):
    suite = load_sensors("flight_thrust", unstated="exact")
    again = pickle.loads(pickle.dumps(suite))
    assert again.thrusters == suite.thrusters or vars(again).keys() == vars(suite).keys()
    scenario = pickle.loads(pickle.dumps(paper_scenario))
    assert scenario.simulation.simulator.accuracy == paper_scenario.simulation.simulator.accuracy
    table = pickle.loads(pickle.dumps(servicer.on_table()))
    np.testing.assert_array_equal(table.tree.normal_B, [0, 0, 1])
    assert table.joint_names == servicer.joint_names
    motion = paper_scenario.make_joint_motion(servicer)
    data = servicer.predicted_motion(paper_target, motion, np.arange(0.0, 10.0, 0.5))
    found = identify(servicer, data)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(found)).intervals, found.intervals)
