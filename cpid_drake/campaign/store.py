"""The folder of a campaign: one Parquet file for each chunk of trials. The folder is the truth."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from cpid_drake.campaign.campaign_schema import VERSION, CampaignPlan
from cpid_drake.files.drafts import DRAFT, draft_of, write_errors, write_text
from cpid_drake.files.errors import InputError
from cpid_drake.files.resources import __version__

PLAN = "campaign.json"
"""The file of the campaign's text in its folder."""

_NAME = re.compile(r"trials-(\d+)-(\d+)\.parquet")


def open_folder(folder: Path, plan: CampaignPlan, *, resume: bool) -> None:
    """Prepare a folder for the trials of a campaign.

    Raises:
        InputError: the folder has a campaign already and `resume` is false; or has another one.

    """
    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / PLAN).exists():
            if plan_in(folder).hash != plan.hash:
                raise InputError(
                    f"{folder}: has the trials of another campaign, or its scenario or a file that "
                    "it names has changed; give another folder"
                )
            if not resume:
                raise InputError(
                    f"{folder}: has trials of this campaign; continue it with --resume"
                )
        elif any(folder.iterdir()):
            raise InputError(f"{folder}: has files that belong to no campaign; give another folder")
        else:
            write_text(folder / PLAN, plan.text)
        for drafts in folder.glob(f"{DRAFT}*"):  # of a process that was killed
            shutil.rmtree(drafts)


def plan_in(folder: Path) -> CampaignPlan:
    """Return the plan of the campaign in a folder.

    Raises:
        InputError: there is none, or it cannot be read.

    """
    try:
        return CampaignPlan((folder / PLAN).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{folder}: no folder of a campaign: {PLAN}: {error.strerror}") from error
    except (ValueError, KeyError) as error:
        raise InputError(f"{folder}: {PLAN} cannot be read: {error}") from error


def write_chunk(folder: Path, plan: CampaignPlan, first: int, table: pa.Table, last: int) -> None:
    """Write the rows of trials first, …, last − 1 as one file, which is whole when it appears.

    Raises:
        InputError: the file cannot be written.

    """
    about = {"version": VERSION, "campaign": plan.hash, "cpid_drake": __version__}
    table = table.replace_schema_metadata({key: str(value) for key, value in about.items()})
    name = f"trials-{first:09d}-{last - 1:09d}.parquet"
    with draft_of(folder / name) as draft:
        pq.write_table(table, draft, compression="zstd")


def chunks(folder: Path, plan: CampaignPlan) -> dict[tuple[int, int], Path]:
    """Return the files of a campaign by their first trial and the one after their last, in order.

    Raises:
        InputError: a file is damaged, or belongs to another campaign.

    """
    chunks = {}
    for path in sorted(folder.glob("trials-*.parquet")):
        try:
            about = pq.read_schema(path).metadata
        except (OSError, pa.ArrowInvalid) as error:
            raise InputError(
                f"{path}: damaged: {error}; delete it, and --resume computes its trials again"
            ) from error
        match = _NAME.fullmatch(path.name)
        if match is None or (about or {}).get(b"campaign") != plan.hash.encode():
            raise InputError(f"{path}: belongs to another campaign; move it away")
        chunks[int(match[1]), int(match[2]) + 1] = path
    return chunks


def missing(folder: Path, plan: CampaignPlan, size: int) -> list[tuple[int, int]]:
    """Return the chunks of trials, of at most this size, that are not in a folder."""
    ranges, at = list[tuple[int, int]](), 0
    for first, last in [*chunks(folder, plan), (plan.total, plan.total)]:
        starts = range(at, first, size)
        ranges += [(start, min(start + size, first)) for start in starts]
        at = max(at, last)
    return ranges


def read(folder: Path, plan: CampaignPlan) -> Iterator[pa.Table]:
    """Yield the rows of a campaign, one file after the other."""
    for path in chunks(folder, plan).values():
        yield pq.read_table(path)
