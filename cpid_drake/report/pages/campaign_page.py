"""The page of a campaign, with its tables as CSV and the scenarios of its worst trials."""

from pathlib import Path

from cpid_drake.campaign.statistics import Statistics
from cpid_drake.campaign.trial import replayed
from cpid_drake.report import campaign_tables
from cpid_drake.report.page import Report
from cpid_drake.report.pages.study import study_report
from cpid_drake.simulation.scenario_files import dump_scenario


def campaign_report(found: Statistics, folder: Path) -> Report:
    """Return the report of the campaign in a folder."""
    campaign, sections = found.plan.campaign, campaign_tables.sections(found)
    subtitle = (
        f"Scenario {campaign.scenario}, {found.done} of {found.plan.total} trials, seed "
        f"{campaign.seed}"
    )
    points = [campaign_tables.errors(found, point) for point in range(len(found.plan.points))]
    tables = {f"errors-{point}": table for point, table in enumerate(points)}
    for each in (campaign_tables.requirements, campaign_tables.checks, campaign_tables.failures,
                 campaign_tables.axes, campaign_tables.worst):  # fmt: skip
        tables[each.__name__] = each(found)
    files = {f"{name}.csv": table.csv() for name, table in tables.items()}
    for number in {each.trial for cases in found.worst.values() for each in cases}:
        files[campaign_tables.scenario_name(number)] = dump_scenario(replayed(found.plan, number))
    facts = [("Scenario", campaign.scenario), ("Campaign", found.plan.hash)]
    words = ["cpid", "campaign", "report", str(folder)]
    return study_report("Campaign", subtitle, sections, facts, words, files)
