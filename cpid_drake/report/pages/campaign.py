"""The page of a campaign, with its tables as CSV and the scenarios of its worst trials."""

import shlex
from pathlib import Path

from cpid_drake.output_files.drafts import write_text
from cpid_drake.report import campaign_tables
from cpid_drake.report.page import Report, Section
from cpid_drake.report.sections.data import written_by
from cpid_drake.scenario.files import dump_scenario
from cpid_drake.studies.campaign.statistics import Statistics
from cpid_drake.studies.campaign.trial import replayed


def campaign_report(found: Statistics, folder: Path) -> Report:
    """Return the report of the campaign in a folder."""
    campaign, words = found.plan.campaign, ["cpid", "study", "report", str(folder)]
    subtitle = (
        f"Scenario {campaign.scenario}, {found.done} of {found.plan.total} trials, seed "
        f"{campaign.seed}"
    )
    facts = [("Scenario", campaign.scenario), ("Campaign", found.plan.hash), written_by()]
    provenance = Section("Provenance", facts=facts, command=shlex.join(words))
    return Report("Campaign", subtitle, [*campaign_tables.sections(found), provenance])


def write_campaign(folder: Path, page: Report, found: Statistics) -> None:
    """Write the page of a campaign, its figures, its tables, and scenarios of its worst trials."""
    page.save_figures(folder)
    page.write(folder / "report.html")
    points = [campaign_tables.errors(found, point) for point in range(len(found.plan.points))]
    tables = {f"errors-{point}": table for point, table in enumerate(points)}
    for each in (campaign_tables.requirements, campaign_tables.checks, campaign_tables.failures,
                 campaign_tables.axes, campaign_tables.worst):  # fmt: skip
        tables[each.__name__] = each(found)
    for name, table in tables.items():
        write_text(folder / f"{name}.csv", campaign_tables.as_csv(table))
    for number in {each.trial for cases in found.worst.values() for each in cases}:
        scenario = dump_scenario(replayed(found.plan, number))
        write_text(folder / campaign_tables.scenario_name(number), scenario)
