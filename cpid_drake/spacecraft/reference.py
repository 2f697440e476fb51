"""How files, results and requests name a spacecraft."""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cpid_drake.files.constraints import Limits
from cpid_drake.files.resources import from_folder

if TYPE_CHECKING:
    from cpid_drake.spacecraft.spacecraft import Spacecraft

Name = Annotated[str, Limits(min_length=1)]


@dataclass
class SpacecraftReference:
    """A spacecraft by its model file.

    Attributes:
        model: a path or a `package://NAME/...` URI.
        base: name of its base body.
        capture_frame: name of the frame C that holds the target.
        packages: folders, by name, of packages that the model's URIs refer to.
        repair_bodies: "nearest" to take the nearest body in the place of one that cannot be.

    """

    model: Name
    base: Name
    capture_frame: Name
    packages: dict[str, str] = field(default_factory=dict)
    repair_bodies: Literal["nearest"] | None = None

    def make(self) -> "Spacecraft":
        """Return the spacecraft.

        Raises:
            InputError: for the same reasons as `Spacecraft`.

        """
        # Results name a spacecraft, and are read without Drake.
        from cpid_drake.spacecraft.spacecraft import Spacecraft

        return Spacecraft(
            self.model,
            base=self.base,
            capture_frame=self.capture_frame,
            packages=self.packages,
            repair_bodies=self.repair_bodies,
        )

    def resolve(self, folder: Path) -> None:
        """Make the paths absolute; relative ones start at a folder.

        Raises:
            InputError: a path names a user that does not exist.

        """
        self.model = from_folder(folder, self.model)
        places = self.packages.items()
        self.packages = {name: from_folder(folder, place) for name, place in places}

    def reference(self) -> "SpacecraftReference":
        """Return these five entries alone, without those of a derived class."""
        names = (field.name for field in fields(SpacecraftReference))
        return SpacecraftReference(**{name: getattr(self, name) for name in names})
