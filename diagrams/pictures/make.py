#!/usr/bin/env python3
"""Make the README's pictures and tables again: `python diagrams/pictures/make.py [NAME ...]`.

It runs the commands that the README shows; `accuracy` takes three minutes on two cores. All
but the Diagram are pages in Chromium, driven by Playwright.
"""

import argparse
import runpy
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pydot
from PIL import Image

HERE = Path(__file__).resolve().parent
MODELS = HERE.parents[1] / "models"
SAMPLE = (
    *("identify", MODELS / "telemetry/free_flyer.csv"),
    *("--model", MODELS / "free_flyer/free_flyer.urdf"),
    *("--base", "body", "--capture-frame", "capture_point", "--sensors", "testbed"),
)
WHEN = 6.0
"""The moment of the scene that is shown [s]."""


def cpid(*arguments: object) -> str:
    """Run `cpid` and return what it prints."""
    command = [sys.executable, "-m", "cpid_drake", *map(str, arguments)]
    return subprocess.run(command, check=True, text=True, stdout=subprocess.PIPE).stdout


def identify(folder: Path) -> None:
    """Draw the Diagram of `identify.py` with the ports that are connected; needs Graphviz."""
    diagram = runpy.run_path(str(HERE.parent / "identify.py"))["simulator"].get_system()
    edges, ports = [], {}
    for (reader, in_index), (writer, out_index) in diagram.connection_map().items():
        names = [reader.get_name(), writer.get_name()]
        if any(
            word in name
            for name in names
            for word in ("drake_vis", "contact", "proximity", "inertia")
        ):
            continue  # Drake's visualization for other viewers, and of contacts and inertias
        in_name = reader.get_input_port(in_index).get_name()
        out_name = writer.get_output_port(out_index).get_name()
        if "deformable" in out_name:
            continue
        ports.setdefault(reader, ([], []))[0].append(in_name)
        outputs = ports.setdefault(writer, ([], []))[1]
        outputs += [] if out_name in outputs else [out_name]
        edges.append((f"{id(writer)}:{out_name}:e", f"{id(reader)}:{in_name}:w"))
    graph = pydot.Dot(graph_type="digraph", rankdir="LR", ranksep=0.7, fontname="sans", dpi=110)
    graph.set_node_defaults(shape="record", fontname="sans", fontsize=11)
    for system, sides in ports.items():
        left, right = ("|".join(f"<{name}> {name}" for name in side) for side in sides)
        title = type(system).__name__.split("_")[0]
        columns = [f"{{{side}}}" for side in (left, right) if side]
        label = f"{title}|{{{'|'.join(columns)}}}"
        color = "#fff3d6" if "cpid_drake" in type(system).__module__ else "#eeeeee"
        graph.add_node(pydot.Node(id(system), label=label, style="filled", fillcolor=color))
    for writer, reader in edges:
        graph.add_edge(pydot.Edge(writer, reader))
    graph.write_png(str(HERE / "identify.png"))


@contextmanager
def shown(file: Path, width: int, height: int) -> Iterator[Any]:
    """Provide a page that is open in Chromium."""
    from playwright.sync_api import sync_playwright

    browser_path = shutil.which("chromium") or shutil.which("chromium-browser")
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=flags)
        page = browser.new_page(viewport={"width": width, "height": height})
        page.goto(file.as_uri())
        yield page
        browser.close()


def keep_figures(file: Path, section: str, name: str) -> None:
    """Write the figures of a section of a page as a PNG beside this script."""
    with shown(file, 1100, 2400) as page:
        page.locator(f"#{section}").evaluate("each => { each.open = true; }")
        figures = page.locator(f"#{section} .figures")
        figures.scroll_into_view_if_needed()
        figures.locator(".plot .main-svg").last.wait_for()
        page.wait_for_timeout(500)
        figures.screenshot(path=HERE / f"{name}.png")


@contextmanager
def seekable(file: Path, width: int, height: int) -> Iterator[Callable[[float], bytes]]:
    """Provide a function from a time [s] to the PNG of a recorded scene at it, in Chromium."""
    with shown(file, width, height) as page:
        page.wait_for_function("viewer.animator.duration > 0")
        page.add_style_tag(content=".dg { display: none !important }")  # the bar of the controls

        def picture(time: float) -> bytes:
            page.evaluate(
                "t => { viewer.animator.pause(); viewer.animator.time = t; "
                "viewer.animator.seek(t); viewer.set_dirty(); }",
                time,
            )
            page.wait_for_timeout(700)
            return page.screenshot()

        yield picture


def scene(folder: Path) -> None:
    """Draw the free-flyer with its bag, as `cpid view` shows it."""
    page_file = folder / "view.html"
    cpid("view", "free_flyer_payload", "--out", page_file, "--quiet")
    with seekable(page_file, 1200, 675) as picture:
        picture(WHEN)
        (HERE / "scene.png").write_bytes(picture(WHEN))


def moving(folder: Path) -> None:
    """Draw what `sensors.py` records: the arms move, and the ellipsoid of 3 σ shrinks."""
    script = HERE.parent / "sensors.py"
    subprocess.run([sys.executable, script], check=True, cwd=folder, stdout=subprocess.DEVNULL)
    times = np.arange(0, 10, 0.25)
    with seekable(folder / "scene.html", 960, 540) as picture:
        frames = [Image.open(BytesIO(picture(time))).convert("RGB") for time in times]
    frames = [frame.resize((720, 405), Image.Resampling.LANCZOS) for frame in frames]
    sheet = Image.new("RGB", (720, 405 * 2))  # one palette, so that nothing flickers
    for k, frame in enumerate((frames[len(frames) // 2], frames[-1])):
        sheet.paste(frame, (0, 405 * k))
    palette = sheet.quantize(192, Image.Quantize.MAXCOVERAGE)
    plain = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    durations = [150] * (len(plain) - 1) + [2500]  # [ms]
    plain[0].save(
        HERE / "moving.gif", save_all=True, append_images=plain[1:], duration=durations, loop=0
    )


def page(folder: Path) -> None:
    """Draw the first screen of the page that the README's command writes, while its scene plays."""
    telemetry = MODELS / "telemetry"
    sensors = ("--sensors", telemetry / "free_flyer_sensors.yaml")
    log = (telemetry / "free_flyer.csv", *sensors, "--spacecraft", "free_flyer_payload")
    cpid("identify", *log, "--report", folder / "bag.html", "--quiet")
    with shown(folder / "bag.html", 1400, 880) as opened:
        opened.wait_for_timeout(1000 * WHEN)
        picture = Image.open(BytesIO(opened.screenshot())).convert("RGB")
    picture.quantize(128, Image.Quantize.MAXCOVERAGE).save(HERE / "page.png", optimize=True)


def convergence(folder: Path) -> None:
    """Draw how the estimate from the sample log converges."""
    cpid(*SAMPLE, "--report", folder / "bag.html", "--quiet")
    keep_figures(folder / "bag.html", "convergence", "convergence")


def paper(folder: Path) -> None:
    """Draw the paper's study."""
    script = HERE.parent / "paper/run.py"
    subprocess.run([sys.executable, script, "--out", folder / "paper"], check=True)
    names = {
        "configurations-fig-3": "figure3_configurations",
        "mass-against-decimals-table-2": "table2_decimals",
    }
    for section, picture in names.items():
        keep_figures(folder / "paper/report.html", section, picture)


def accuracy(folder: Path) -> None:
    """Draw the comparison of the estimators, and print its table."""
    campaign = HERE.parents[1] / "models/campaigns/estimators.yaml"
    cpid("campaign", "run", campaign, "--out", folder / "accuracy")
    print(cpid("campaign", "report", folder / "accuracy"))
    keep_figures(folder / "accuracy/report.html", "errors", "accuracy_flight")


def adaptive_control(folder: Path) -> None:
    """Draw the tracking errors of the adaptive controller, and print their table."""
    script, page = HERE.parent / "adaptive_control.py", folder / "errors.html"
    subprocess.run([sys.executable, script, "--figure", page], check=True, cwd=folder)
    keep_figures(page, "errors", "adaptive_control")


def plan_identify_replan(folder: Path) -> None:
    """Draw σ and the tracking errors of the closed loop, and print what it found."""
    name = "plan_identify_replan"
    script, page = HERE.parent / f"{name}.py", folder / "loop.html"
    subprocess.run([sys.executable, script, "--figure", page], check=True, cwd=folder)
    keep_figures(page, "errors", name)


PICTURES: dict[str, Callable[[Path], None]] = {
    picture.__name__: picture
    for picture in (
        identify,
        scene,
        moving,
        page,
        convergence,
        paper,
        accuracy,
        adaptive_control,
        plan_identify_replan,
    )
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
