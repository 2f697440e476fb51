#!/usr/bin/env python3
"""Make the README's pictures and tables again: `python diagrams/pictures/make.py [NAME ...]`.

It runs the commands that the README shows; `accuracy` takes three minutes on two cores. The
picture of the scene is a page of `cpid view` in Chromium, driven by Playwright.
"""

import argparse
import runpy
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pydot

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


def scene(folder: Path) -> None:
    """Draw the free-flyer with its bag, as `cpid view` shows it."""
    from playwright.sync_api import sync_playwright

    page_file = folder / "view.html"
    cpid("view", "free_flyer_payload", "--out", page_file, "--quiet")
    browser_path = shutil.which("chromium") or shutil.which("chromium-browser")
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=flags)
        page = browser.new_page(viewport={"width": 1200, "height": 675})
        page.goto(page_file.as_uri())
        page.wait_for_function("viewer.animator.duration > 0")
        page.evaluate(
            "t => { viewer.animator.pause(); viewer.animator.time = t; viewer.animator.seek(t); "
            "viewer.set_dirty(); }",
            WHEN,
        )
        page.wait_for_timeout(3000)
        page.screenshot(path=HERE / "scene.png")
        browser.close()


def convergence(folder: Path) -> None:
    """Draw how the estimate from the sample log converges."""
    cpid(*SAMPLE, "--json", folder / "bag.json", "--quiet")
    report = ("report", "--result", folder / "bag.json", "--out", folder / "bag.html", "--quiet")
    cpid(*report, "--figures", folder / "figures")
    shutil.copy(folder / "figures/convergence.png", HERE)


def paper(folder: Path) -> None:
    """Draw the paper's study."""
    script = HERE.parent / "paper/run.py"
    subprocess.run([sys.executable, script, "--out", folder / "paper"], check=True)
    names = {
        "configurations-fig-3": "figure3_configurations",
        "mass-against-decimals-table-2": "table2_decimals",
    }
    for name, picture in names.items():
        shutil.copy(folder / "paper" / f"{name}.png", HERE / f"{picture}.png")


def accuracy(folder: Path) -> None:
    """Draw the comparison of the estimators, and print its table."""
    campaign = HERE.parents[1] / "models/campaigns/estimators.yaml"
    cpid("campaign", "run", campaign, "--out", folder / "accuracy")
    print(cpid("campaign", "report", folder / "accuracy"))
    shutil.copy(folder / "accuracy/errors.png", HERE / "accuracy_flight.png")


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
    for picture in (
        identify,
        scene,
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
