#!/usr/bin/env python3
"""Make the README's pictures and tables again: `python diagrams/pictures/make.py [NAME ...]`.

It runs the commands that the README shows; `accuracy` takes three minutes on two cores. The
picture of the scene is a page of `cpid view` in Chromium, driven by Playwright.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

HERE = Path(__file__).resolve().parent
MODELS = HERE.parents[1] / "models"
SAMPLE = (
    *("identify", MODELS / "telemetry/free_flyer.csv"),
    *("--spacecraft", MODELS / "free_flyer/free_flyer.urdf"),
    *("--base", "body", "--capture-frame", "capture_point", "--sensors", "testbed"),
)
WHEN = 6.0
"""The moment of the scene that is shown [s]."""


def cpid(*arguments: object) -> str:
    """Run `cpid` and return what it prints."""
    command = [sys.executable, "-m", "cpid_drake", *map(str, arguments)]
    return subprocess.run(command, check=True, text=True, stdout=subprocess.PIPE).stdout


def scene(folder: Path) -> None:
    """Draw the free-flyer with its bag, as `cpid view` shows it."""
    from playwright.sync_api import sync_playwright

    page_file = folder / "view.html"
    cpid("view", "--scenario", "free_flyer_payload", "--out", page_file, "--quiet")
    browser_path = shutil.which("chromium") or shutil.which("chromium-browser")
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=flags)
        page = browser.new_page(viewport={"width": 1200, "height": 675})
        page.goto(page_file.as_uri())
        page.wait_for_function("viewer.animator.duration > 0")
        page.locator("#cpid-time button").click()  # pause
        page.wait_for_function("!viewer.animator.playing")
        slider = page.locator("#cpid-time input")
        slider.evaluate(
            "(bar, t) => { bar.value = t; bar.dispatchEvent(new Event('input')); }", WHEN
        )
        page.wait_for_timeout(3000)
        page.screenshot(path=HERE / "scene.png")
        browser.close()


def convergence(folder: Path) -> None:
    """Draw how the estimate from the sample log converges."""
    cpid(*SAMPLE, "--json", folder / "bag.json", "--quiet")
    report = ("report", folder / "bag.json", "--out", folder / "bag.html", "--quiet")
    cpid(*report, "--figures", folder / "figures")
    shutil.copy(folder / "figures/convergence.png", HERE)


def paper(folder: Path) -> None:
    """Draw the paper's study."""
    print(cpid("paper", "--out", folder / "paper"))
    for name in ("figure3_configurations.png", "table2_decimals.png"):
        shutil.copy(folder / "paper" / name, HERE)


def accuracy(folder: Path) -> None:
    """Draw the comparison of the estimators, and print its table."""
    study = ("study", "accuracy", "exciting_motion", "--sensors", "flight")
    print(cpid(*study, "--out", folder / "accuracy"))
    shutil.copy(folder / "accuracy/accuracy_flight.png", HERE)


def adaptive_control(folder: Path) -> None:
    """Draw the tracking errors of the adaptive controller, and print their table."""
    script, picture = HERE.parent / "adaptive_control.py", HERE / "adaptive_control.png"
    subprocess.run([sys.executable, script, "--figure", picture], check=True, cwd=folder)


def plan_identify_replan(folder: Path) -> None:
    """Draw σ and the tracking errors of the closed loop, and print what it found."""
    name = "plan_identify_replan"
    script, picture = HERE.parent / f"{name}.py", HERE / f"{name}.png"
    subprocess.run([sys.executable, script, "--figure", picture], check=True, cwd=folder)


PICTURES: dict[str, Callable[[Path], None]] = {
    picture.__name__: picture
    for picture in (scene, convergence, paper, accuracy, adaptive_control, plan_identify_replan)
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help=f"of {', '.join(PICTURES)}; default: all")
    names = parser.parse_args().names or list(PICTURES)
    for name in names:
        if name not in PICTURES:
            parser.error(f"no picture '{name}'; choose from {', '.join(PICTURES)}")
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            PICTURES[name](Path(folder))


if __name__ == "__main__":
    main()
