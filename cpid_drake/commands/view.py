"""`cpid view`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from cpid_drake.commands.identify import absolute_model, packages_of
from cpid_drake.errors import InputError

if TYPE_CHECKING:
    from cpid_drake.identification.result_files import SpacecraftReference

MOST_BYTES = 10_000_000
"""Of a page that is to be sent on; what is larger is said."""

_LOGS = (".csv", ".npz", ".parquet", ".db3", ".mcap")


def view(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO|TELEMETRY",
            help="A scenario file, a shipped one's name, or a log of a motion.",
        ),
    ],
    html: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write a replay there: one HTML file, plays offline."),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="With --html: show it live all the same, and write then.")
    ] = False,
    rate: Annotated[
        float, typer.Option(help="Of simulated to real time at first, 0.1 to 5; live only.")
    ] = 1.0,
    spacecraft: Annotated[
        str | None, typer.Option(metavar="MODEL", help="TELEMETRY: the known spacecraft.")
    ] = None,
    base: Annotated[
        str | None, typer.Option(metavar="NAME", help="TELEMETRY: its base body.")
    ] = None,
    capture_frame: Annotated[
        str | None, typer.Option(metavar="NAME", help="TELEMETRY: the frame that holds the target.")
    ] = None,
    sensors: Annotated[
        str | None, typer.Option(metavar="PRESET|YAML", help="TELEMETRY: as for `identify`.")
    ] = None,
    unknown_momentum: Annotated[
        bool, typer.Option("--unknown-momentum", help="TELEMETRY: as for `identify`.")
    ] = False,
    package: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=FOLDER", help="TELEMETRY: as for `identify`."),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but warnings.")] = False,
) -> None:
    """Look at a scenario, live in the browser or as a page; or replay a log as a page.

    Live, the arms can be posed by sliders before a run; it starts where the scenario does.
    """
    from cpid_drake.commands.report import check_page
    from cpid_drake.identification.result_files import SpacecraftReference

    if html is not None:
        check_page("--html", html)
    if not 0.1 <= rate <= 5:
        raise InputError(f"--rate {rate:g}: must be from 0.1 to 5")
    console = Console(stderr=True, quiet=quiet, markup=False, highlight=False, soft_wrap=True)
    craft = {"--spacecraft": spacecraft, "--base": base, "--capture-frame": capture_frame}
    missing = [option for option, value in craft.items() if value is None]
    if len(missing) < len(craft) or source.lower().endswith(_LOGS):
        if missing:
            raise InputError(f"{source}: a log's spacecraft must be known: give {missing[0]}")
        if html is None or live:
            raise InputError(f"{source}: a log is replayed as a page: give --html FILE, no --live")
        reference = SpacecraftReference(
            absolute_model(spacecraft), base, capture_frame, packages_of(package)
        )
        page, text = _replay_log(source, reference, sensors, unknown_momentum, console)
    else:
        of_logs = {"--sensors": sensors, "--unknown-momentum": unknown_momentum}
        for option, value in (of_logs | {"--package": package}).items():
            if value:
                raise InputError(f"{option} is for logs; a scenario says it itself")
        page, text = _show_scenario(source, html is not None, html is None or live, rate, console)
    if html is not None:
        html.write_text(page, encoding="utf-8")
        size = html.stat().st_size
        console.print(f"{html}, {size / 1e6:.1f} MB")
        if size > MOST_BYTES:
            Console(stderr=True, markup=False).print("warning: large, since the model's meshes are")
    if not quiet:
        print(text)


def _replay_log(
    telemetry: str,
    spacecraft: "SpacecraftReference",
    sensors: str | None,
    unknown_momentum: bool,
    console: Console,
) -> tuple[str, str]:
    """Return the page of a log, and the estimate in words."""
    from cpid_drake.identification.convergence import converge
    from cpid_drake.identification.requests import Request, identify_file
    from cpid_drake.report.replay import estimate_text, replay_html
    from cpid_drake.report.sections.replay import motion_of

    with console.status("identifying") as status:
        request = Request(telemetry, spacecraft, sensors=sensors, unknown_momentum=unknown_momentum)
        evidence = identify_file(request, status.update)
        estimates = converge(evidence, status.update).estimates
        status.update("drawing")
        page = replay_html(
            evidence.spacecraft, motion_of(evidence), estimates, title=Path(telemetry).name
        )
    for warning in evidence.result.warnings:
        Console(stderr=True, markup=False).print(f"warning: {warning}", soft_wrap=True)
    return page, estimate_text(evidence.found.identification)


def _show_scenario(
    source: str, as_page: bool, as_live: bool, rate: float, console: Console
) -> tuple[str | None, str]:
    """Return the page of a scenario, if it is wanted, and the estimate in words."""
    from cpid_drake.report.live_view import LiveView
    from cpid_drake.report.replay import estimate_text, replay_simulation
    from cpid_drake.scenario.files import load_scenario
    from cpid_drake.scenario.naming import naming
    from cpid_drake.scenario.shipped import find_scenario
    from cpid_drake.scenario.simulation import make_simulation
    from cpid_drake.systems.scene_visualizer import open_meshcat

    page = text = None
    with console.status("reading the scenario") as status:
        scenario = load_scenario(find_scenario(source))
        with naming(source):
            simulation = make_simulation(scenario)  # complains, if it does, before a page is opened
        duration = scenario.simulation.duration
        if as_live:
            meshcat = open_meshcat("*")
            live = LiveView(make_simulation(scenario, meshcat=meshcat), meshcat, rate)
            typer.echo(f"Open {meshcat.web_url()} and there Open Controls: Start, Stop", err=True)
            status.update("waiting for Start; until then sliders pose the arms, for looking only")

            def on_frame(time, identification) -> None:
                nonlocal text
                text = estimate_text(identification, simulation.truth)
                status.update(f"{time:.1f} of {duration:g} s; {_one_line(text)}")

            live.serve(on_frame)
        if as_page:
            page, last = replay_simulation(
                simulation,
                lambda time: status.update(f"simulated {time:.1f} of {duration:g} s"),
                title=Path(source).stem,
            )
            text = estimate_text(last, simulation.truth)
    return page, text or "no run"


def _one_line(text: str) -> str:
    return "; ".join(line.strip() for line in text.splitlines())
