"""The scene in a real browser: the replay plays offline, the live page obeys its controls."""

import gc
import io
import queue
import threading

import numpy as np
import pytest
from flyer_cases import payload
from PIL import Image
from processes import HUNG

from cpid_drake import LivePage, make_simulation
from cpid_drake.commands.main import app
from cpid_drake.report.live_view import STOP, serve
from cpid_drake.simulation.scenario_files import dump_scenario

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def replay(tmp_path_factory):
    folder = tmp_path_factory.mktemp("replay")
    (folder / "scenario.yaml").write_text(dump_scenario(payload(4.0, 1e-7)))
    arguments = ["view", str(folder / "scenario.yaml"), "--quiet"]
    app([*arguments, "--out", str(folder / "replay.html")], result_action="return_value")
    return (folder / "replay.html").as_uri()


def pixels(page) -> np.ndarray:
    """What the page shows, (height, width, 3) of 0 to 1."""
    return np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB")) / 255


def settled(page) -> np.ndarray:
    """What the page shows when all that was asked for is drawn."""
    page.evaluate(
        "async () => { for (const _ of [1, 2, 3]) await new Promise(requestAnimationFrame); }"
    )
    return pixels(page)


def scene(picture: np.ndarray) -> np.ndarray:
    """The middle of the page, where no text is."""
    height, width, _ = picture.shape
    return picture[height // 4 : 3 * height // 4, width // 3 :]


def drawn(picture: np.ndarray) -> float:
    """The part of the scene that is not the dark background."""
    return float((scene(picture).max(axis=2) > 0.2).mean())


def changed(before: np.ndarray, after: np.ndarray) -> float:
    """The part of the scene that is other than before."""
    return float((np.abs(scene(after) - scene(before)).max(axis=2) > 0.1).mean())


def ready(page) -> None:
    page.wait_for_function("viewer.animator.duration > 0")
    page.evaluate("viewer.animator.pause()")
    page.wait_for_function("!viewer.animator.playing")


def seek(page, time: float) -> np.ndarray:
    """Move Meshcat's own slider of the time."""
    page.evaluate(
        "time => { viewer.animator.time = time; viewer.animator.seek(time); viewer.set_dirty(); }",
        time,
    )
    return settled(page)


def has(page, path: str) -> bool:
    """Whether a path is in the scene tree with something under it; looking changes nothing."""
    return page.evaluate(
        """path => {
            let node = viewer.scene_tree;
            for (const name of path.split("/")) node = node?.children[name];
            return node !== undefined && node.object.children.length > 0;
        }""",
        path,
    )


def test_the_replay_plays(open_page, replay):
    """Arms, target and estimate are there, the last frame is not the first, and numbers run."""
    with open_page(replay) as page:
        page.wait_for_function("viewer.animator.time > 0.2")  # it plays by itself
        ready(page)
        first = seek(page, 0.0)
        assert drawn(first) > 0.03
        for path in (
            "drake/illustration/free_flyer/arm_link2",
            "drake/illustration/captured_target",
            "cpid/estimate/inertia",
            "cpid/momentum/linear_target",
        ):
            assert has(page, path), path
        assert page.locator("#cpid-numbers").inner_text().strip() == "0.00 s"
        last = seek(page, 4.0)
        assert changed(first, last) > 0.03
        numbers = page.locator("#cpid-numbers").inner_text()
        assert "from 16 samples" in numbers
        assert "m 8.5000 kg" in numbers


def press(page, name: str) -> None:
    page.evaluate(
        "name => [...document.querySelectorAll('.property-name')]"
        ".find(label => label.textContent === name).click()",
        name,
    )


@pytest.fixture
def live():
    """A live view, served in a thread of its own, as Meshcat wants."""
    urls = queue.Queue()

    def show() -> None:
        simulation = make_simulation(payload(3.0, 1e-7))
        with LivePage(truth=simulation.truth) as page:
            urls.put(page.address)
            serve(simulation, page, 1.0)
        del simulation, page
        gc.collect()

    gc.collect()
    thread = threading.Thread(target=show, daemon=True)
    thread.start()
    return urls.get(timeout=HUNG), thread


def test_the_live_page_shows_a_run_and_then_its_recording(open_page, live):
    """The run starts when a page is open, and shows its numbers; Stop ends the command."""
    url, thread = live
    with open_page(url, 1000, 800) as page:
        page.wait_for_selector("#scene")
        [_, scene] = page.frames
        scene.wait_for_function("'viewer' in window && viewer.scene_tree.children.drake")
        scene.wait_for_function("viewer.animator.duration > 2.9")
        page.wait_for_function("document.querySelector('#mass').textContent.includes('m = 8.5')")
        assert "m 8.50" in scene.content()
        for path in (
            "drake/illustration/free_flyer/arm_link2",
            "drake/illustration/captured_target",
            "cpid/momentum/linear_target",
        ):
            assert has(scene, path), path
        press(scene, STOP)
        page.get_by_text("these are the last values").wait_for()
        thread.join(HUNG)
        assert not thread.is_alive()
