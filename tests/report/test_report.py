"""Reports: every number is the result's, text is only text, and what is not there is said."""

import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from flyer_cases import SAMPLE
from sensing_cases import Sines

from cpid_drake import load_spacecraft, write_log
from cpid_drake.identification.identify_files import PARTS_OVER_TIME, converge, identify_files
from cpid_drake.identification.request import Request
from cpid_drake.identification.result_files import result_text, write_result
from cpid_drake.report.contents import collect_contents, collect_contents_of_file
from cpid_drake.report.pages import identification
from cpid_drake.report.pages.identification import identification_report
from cpid_drake.spacecraft.reference import SpacecraftReference

SERVICER = SpacecraftReference(
    "package://cpid_drake_models/dual_arm_servicer/dual_arm_servicer.urdf", "bus", "capture_point"
)
SCRIPT = "</script><script>alert(1)</script>"


class Page(HTMLParser):
    """The elements of a page, and the text of its scripts."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.elements, self.scripts, self.text = [], {}, ""
        self._script = None
        self.feed(html)

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        if tag == "script":
            self._script = dict(attributes).get("id", "")
            self.scripts[self._script] = ""

    def handle_endtag(self, tag):
        self._script = None if tag == "script" else self._script

    def handle_data(self, data):
        if self._script is None:
            self.text += data
        else:
            self.scripts[self._script] += data

    def data(self, name):
        return json.loads(self.scripts[f"data-{name}"])


@pytest.fixture(scope="module", autouse=True)
def quick():
    """No scene: that is tested in a browser."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identification, "replay_html", lambda *args, **options: SCRIPT)
        yield


@pytest.fixture(scope="module")
def states(servicer, skewed_target):
    """The exact states of a motion that conserves momentum."""
    motion = Sines.drawn(len(servicer.joint_names), 4, 6.0)
    return servicer.predicted_motion(skewed_target, motion, np.linspace(0.0, 6.0, 61))


@pytest.fixture
def exact(tmp_path, states):
    """A log without any error."""
    write_log(tmp_path / "exact.csv", states)
    return tmp_path / "exact.csv"


@pytest.fixture
def evidence(exact):
    return identify_files([Request(str(exact), SERVICER)])


@pytest.fixture
def result_file(evidence, tmp_path):
    write_result(tmp_path / "result.json", evidence.result)
    return tmp_path / "result.json"


@pytest.fixture(scope="module")
def html(tmp_path_factory, states):
    folder = tmp_path_factory.mktemp("report")
    write_log(folder / "exact.csv", states)
    found = identify_files([Request(str(folder / "exact.csv"), SERVICER)])
    write_result(folder / "result.json", found.result)
    return identification_report(collect_contents_of_file(folder / "result.json")).html()


class TestPage:
    def test_it_holds_the_file_and_shows_its_numbers(self, html, result_file):
        page, file = Page(html), json.loads(result_file.read_text())
        file["sources"] = page.data("result")["sources"]  # other folders
        assert page.data("result") == file
        for value in file["parameters"]:
            assert f"{round(value, 6) + 0.0:.6f}" in page.text

    def test_nothing_is_fetched(self, html):
        for tag, attributes in Page(html).elements:
            assert tag not in ("object", "embed", "svg", "iframe")
            assert attributes.get("src", "data:").startswith("data:")
            assert re.match(r"#|data:", attributes.get("href", "#")), attributes

    def test_what_users_write_is_only_text(self, exact, tmp_path):
        log = exact.rename(tmp_path / "<script>alert(1)<x>.csv")
        found = identify_files([Request(str(log), SERVICER)])
        object.__setattr__(found.result, "warnings", (SCRIPT, "{{ 7 * 7 }}"))
        page = Page(identification_report(collect_contents(found)).html())
        assert page.scripts.keys() == {"data-result", "data-scene", ""}
        assert "alert" not in page.scripts[""]
        assert page.text.count(SCRIPT) == 1
        assert "{{ 7 * 7 }}" in page.text
        assert page.data("result")["warnings"][0] == SCRIPT
        assert page.data("scene") == SCRIPT
        assert "<script>alert(1)<x>.csv" in page.text


class TestWhatIsSaid:
    def test_without_the_log_the_result_alone_is_shown(self, result_file, exact):
        exact.unlink()
        page = Page(identification_report(collect_contents_of_file(result_file)).html())
        assert f"{exact} does not exist any more" in page.text
        assert ">Convergence<" not in page.text
        assert "data-scene" not in page.scripts
        assert page.data("result")["parameters"][0] == pytest.approx(60.0)

    def test_a_log_that_changed_is_not_used(self, result_file, exact):
        exact.write_text(exact.read_text() + "\n")
        contents = collect_contents_of_file(result_file)
        assert contents.evidence is None
        assert "has changed since: its SHA-256 differs" in contents.missing

    def test_another_estimate_than_the_file_s_is_warned_of(self, evidence, tmp_path):
        document = json.loads(result_text(evidence.result, ""))
        document["parameters"][0] += 1.0
        (tmp_path / "r.json").write_text(json.dumps(document))
        page = Page(identification_report(collect_contents_of_file(tmp_path / "r.json")).html())
        assert "the values differ from those of the result file" in page.text


class TestFigures:
    def test_convergence_ends_at_the_estimate_and_has_gaps_before_it(self, exact):
        evidence = identify_files([Request(str(exact), SERVICER, end=1.15)])
        found = converge(evidence)
        (_, first), *_, (time, last) = found
        assert time == pytest.approx(1.1)
        assert last is evidence.result
        assert np.isnan(first.parameters[4:]).all()  # two samples leave something open

    def test_parts_are_read_as_the_whole_log(self):
        """Many conventions explain a moment of a motion: they are judged once, by all of it."""
        craft = load_spacecraft("free_flyer_payload")
        request = Request.of(craft, SAMPLE, "testbed", estimator="least_squares", end=2.0)
        found = converge(identify_files([request]))
        assert len(found) == PARTS_OVER_TIME
        assert not any("most likely" in text for _, each in found for text in each.failures)
