"""Commands that write, processes that are killed while they write, and what is left of the files.

Each command runs in a folder with an earlier output. Afterwards every output must be the old one or
the new one, whole; the files of a run must all be old or all new, or be marked as unfinished; no
input may have changed.
"""

import os
import random
import shutil
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from processes import HUNG, finish, start

from cpid_drake.output_files.drafts import UNFINISHED
from cpid_drake.resources import models_directory

MODEL = models_directory() / "free_flyer/free_flyer.urdf"
CRAFT = ("--spacecraft", MODEL, "--base", "body", "--capture-frame", "capture_point")
FIT = (*CRAFT, "--estimator", "least_squares", "--sensors", "testbed")


@dataclass(frozen=True)
class Writer:
    """A command that writes.

    Attributes:
        name: its name.
        new: arguments of the run that is killed.
        old: arguments of the run that made the earlier output.
        outputs: groups of files; those of a group belong together.

    """

    name: str
    new: tuple[object, ...]
    old: tuple[object, ...]
    outputs: tuple[tuple[str, ...], ...]


def _with(log: str, *rest: object) -> tuple[object, ...]:
    return ("identify", log, *FIT, *rest)


_RUN = ("telemetry.csv", "truth.csv", "truth.json", "scenario.yaml", "sensors.yaml", "run.json")
WRITERS = {
    writer.name: writer
    for writer in (
        Writer(
            "json",
            _with("log.csv", "--json", "r.json", "--force"),
            _with("old.csv", "--json", "r.json"),
            (("r.json",),),
        ),
        Writer(
            "simulate",
            ("simulate", "new.yaml", "--out", "run", "--force"),
            ("simulate", "old.yaml", "--out", "run"),
            (tuple(f"run/{name}" for name in _RUN),),
        ),
    )
}


class Bench:
    """A folder with inputs and earlier outputs, in which commands are run and killed.

    Args:
        folder: an empty folder.

    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        log = (
            (models_directory() / "telemetry/free_flyer.csv").read_text().splitlines(keepends=True)
        )
        (folder / "log.csv").write_text("".join(log[:302]))
        (folder / "old.csv").write_text("".join(log[:202]))
        text = (models_directory() / "scenarios/free_flyer_payload.yaml").read_text()
        text = text.replace("simulation:\n  duration: 10.0", "simulation:\n  duration: 1.0")
        (folder / "new.yaml").write_text(text)
        (folder / "old.yaml").write_text(text.replace("duration: 1.0", "duration: 0.5", 1))
        self.inputs = {path: path.read_bytes() for path in (*folder.iterdir(), MODEL)}
        self.old: dict[str, dict[str, bytes]] = {}
        self.new: dict[str, dict[str, bytes]] = {}
        for writer in WRITERS.values():
            self._learn(writer)

    def _learn(self, writer: Writer) -> None:
        """Make the earlier output, and learn the new one."""
        self.run(writer.old)
        self.old[writer.name] = self.contents(writer)
        self.run(writer.new)
        self.new[writer.name] = self.contents(writer)

    def run(self, arguments: tuple[object, ...]) -> None:
        """Run a command to its end."""
        ended = finish(start("-m", "cpid_drake", *arguments, cwd=self.folder))
        assert ended.returncode in (0, 3, 4), ended.stderr

    def contents(self, writer: Writer) -> dict[str, bytes]:
        """Return the outputs that exist."""
        names = [name for group in writer.outputs for name in group]
        return {n: (self.folder / n).read_bytes() for n in names if (self.folder / n).exists()}

    def restore(self, writer: Writer) -> None:
        """Put the earlier outputs back, and remove all else that a killed process left."""
        for name in {**self.old[writer.name], **self.new[writer.name]}:
            (self.folder / name).unlink(missing_ok=True)
            ((self.folder / name).parent / UNFINISHED).unlink(missing_ok=True)
        for draft in self.drafts():
            shutil.rmtree(draft) if draft.is_dir() else draft.unlink()
        for name, data in self.old[writer.name].items():
            (self.folder / name).write_bytes(data)

    def drafts(self) -> list[Path]:
        """Return the drafts in the folder and in the folders in it."""
        return [*self.folder.glob(".cpid-draft*"), *self.folder.glob("*/.cpid-draft*")]

    def kill(self, name: str, numbers: random.Random) -> list[str]:
        """Kill a command soon after its first draft appears; return the state of its outputs."""
        writer = WRITERS[name]
        self.restore(writer)
        process = start("-m", "cpid_drake", *writer.new, cwd=self.folder, start_new_session=True)
        while process.poll() is None and not self.drafts():
            time.sleep(1e-4)
        time.sleep(numbers.uniform(0, 0.02))
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate(timeout=HUNG)
        return self.states(writer)

    def states(self, writer: Writer) -> list[str]:
        """Return "old", "new", "unfinished" or a description of a mixture, for each group."""
        for path, data in self.inputs.items():
            assert path.read_bytes() == data, f"{writer.name} changed its input {path}"
        found, old, new = self.contents(writer), self.old[writer.name], self.new[writer.name]
        states = []
        for group in writer.outputs:
            folder = (self.folder / group[0]).parent
            if (folder / UNFINISHED).exists():
                states.append("unfinished")
            elif all(found.get(name) == old.get(name) for name in group):
                states.append("old")
            elif all(_is_whole(found.get(name), new.get(name)) for name in group):
                states.append("new")
            else:
                states.append(f"a mixture: {[name for name in group if name in found]}")
        return states


def _is_whole(found: bytes | None, new: bytes | None) -> bool:
    """Return whether a file is the new one; times in it may differ."""
    if found is None or new is None:
        return found is new
    same_size = abs(len(found) - len(new)) <= 0.02 * len(new) + 40
    return same_size and found[:8] == new[:8] and found[-4:] == new[-4:]
