"""`cpid view`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from cpid_drake.commands import options
from cpid_drake.errors import InputError, prefix_errors
from cpid_drake.resources import find_scenario

if TYPE_CHECKING:
    from cpid_drake.identification.requests import Request
    from cpid_drake.identification.result import Identification

LARGE_PAGE = 10_000_000
"""Size [bytes] of a page above which a warning is printed, because a large page is hard to send."""

_LOGS = (".csv", ".npz", ".parquet", ".db3", ".mcap")


def view(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO|TELEMETRY",
            help="A scenario file, the name of a shipped scenario, or a log.",
        ),
    ],
    html: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write a replay, one HTML file that plays offline."),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="With --html: show the live view first.")
    ] = False,
    rate: Annotated[
        float, typer.Option(help="Initial ratio of simulated to real time in the live view.")
    ] = 1.0,
    spacecraft: options.ModelOption[str | None] = None,
    base: options.BaseOption[str | None] = None,
    capture_frame: options.CaptureFrameOption[str | None] = None,
    sensors: options.SensorsOption = None,
    momentum: options.MomentumOption = None,
    package: options.PackageOption = None,
    quiet: options.QuietOption = False,
) -> None:
    """Show a scenario live in the browser, or write the replay of a scenario or of a log.

    The options from --spacecraft to --package are for logs.

    In the live view, sliders pose the arms before a run; the run starts from the scenario's pose.
    """
    if html is not None:
        options.check_output("--html", html)
    if not 0.1 <= rate <= 5:
        raise InputError(f"--rate {rate:g}: must be from 0.1 to 5")
    console = options.log_console(quiet)
    craft = {"--spacecraft": spacecraft, "--base": base, "--capture-frame": capture_frame}
    missing = [option for option, value in craft.items() if value is None]
    page: str | None
    if source.lower().endswith(_LOGS) or len(missing) < len(craft):
        if spacecraft is None or base is None or capture_frame is None:
            raise InputError(f"{source}: a log needs a spacecraft: give {missing[0]}")
        if html is None or live:
            raise InputError(f"{source}: a log has no live view: give --html FILE, not --live")
        packages, model = options.packages_of(package), options.absolute_model(spacecraft)
        options.check_inputs(source, model, sensors)
        from cpid_drake.identification.requests import Request
        from cpid_drake.identification.result_files import SpacecraftReference

        reference = SpacecraftReference(model, base, capture_frame, packages)
        request = Request(source, reference, sensors=sensors, momentum=momentum or "zero")
        page, text = _replay_log(request, console)
    else:
        for_logs = {"--sensors": sensors, "--momentum": momentum}
        for option, value in (for_logs | {"--package": package}).items():
            if value:
                raise InputError(f"{option} is for logs; a scenario file has its own setting")
        page, text = _show_scenario(source, html is not None, html is None or live, rate, console)
    if html is not None and page is not None:
        html.write_text(page, encoding="utf-8")
        size = html.stat().st_size
        console.print(f"{html}, {size / 1e6:.1f} MB")
        if size > LARGE_PAGE:
            options.log_console().print("warning: the model's meshes make the page large")
    if not quiet:
        print(text)


def _replay_log(request: "Request", console: Console) -> tuple[str, str]:
    """Return the page of a log, and the estimate as text."""
    from cpid_drake.identification.convergence import converge
    from cpid_drake.identification.requests import identify_file
    from cpid_drake.report.replay import estimate_text, replay_html
    from cpid_drake.report.sections.replay import motion_of

    with console.status("identifying") as status:
        evidence = identify_file(request, status.update)
        estimates = converge(evidence, status.update).estimates
        status.update("drawing")
        title = Path(request.telemetry).name
        page = replay_html(evidence.spacecraft, motion_of(evidence), estimates, title=title)
    for warning in evidence.result.warnings:
        options.log_console().print(f"warning: {warning}")
    return page, estimate_text(evidence.found)


def _show_scenario(
    source: str, as_page: bool, as_live: bool, rate: float, console: Console
) -> tuple[str | None, str]:
    """Return the page of a scenario, if it is wanted, and the estimate as text."""
    path = find_scenario(source)
    from cpid_drake.scenario.files import load_scenario

    page, text = None, "no run"
    with console.status("reading the scenario") as status:
        scenario = load_scenario(path)
        from cpid_drake.report.live_view import LiveView
        from cpid_drake.report.replay import estimate_text, replay_simulation
        from cpid_drake.scenario.simulation import make_simulation
        from cpid_drake.systems.scene_visualizer import open_meshcat

        with prefix_errors(source):
            simulation = make_simulation(scenario)  # finds errors before a page is opened
        duration = scenario.simulation.duration
        if as_live:
            meshcat = open_meshcat("*")
            live = LiveView(make_simulation(scenario, meshcat=meshcat), meshcat, rate)
            typer.echo(
                f"Open {meshcat.web_url()} and use Start and Stop in Open Controls", err=True
            )
            status.update("waiting for Start; until then the sliders only pose the arms")

            def on_frame(time: float, identification: "Identification") -> None:
                nonlocal text
                text = estimate_text(identification, simulation.truth)
                line = "; ".join(line.strip() for line in text.splitlines())
                status.update(f"{time:.1f} of {duration:g} s; {line}")

            live.serve(on_frame)
        if as_page:
            page, last = replay_simulation(
                simulation,
                lambda time: status.update(f"simulated {time:.1f} of {duration:g} s"),
                title=Path(source).stem,
            )
            text = estimate_text(last, simulation.truth)
    return page, text
