"""What an export is made of, and what it says about the files that it writes."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from schemas.work_folder import Artifact
from stages.artifacts.field import load_field
from stages.artifacts.scene import SceneData, load_scene
from stages.artifacts.world_axes import file_from_scene
from stages.configs.export import ExportConfig
from stages.run.progress import Context
from stylerf.fields.radiance_field import RadianceField


@dataclass(frozen=True, eq=False)
class ExportedFile:
    """One file of an export.

    Attributes:
        path: inside the artifact, with forward slashes.
        up: axis that is up in it, y or z; "" for the axes of the units as they are.
        file_from_scene: [4, 4] similarity from scene units to its coordinates.
        notes: conventions that the format leaves open, by name.
    """

    path: str
    up: str
    file_from_scene: np.ndarray
    notes: dict[str, object] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class ExportJob:
    """Inputs, options and the folder to write to. inputs: by role, `scene` and, unless cameras, `field`."""

    inputs: dict[str, Artifact]
    config: ExportConfig
    folder: Path
    context: Context

    @cached_property
    def scene(self) -> SceneData:
        """The scene, in scene units."""
        return load_scene(self.inputs["scene"])

    @cached_property
    def field(self) -> RadianceField:
        """The field, as it is rendered: deformed and edited."""
        return load_field(self.inputs["field"])[0]

    def say(self, text: str) -> None:
        """Show the user one line."""
        self.context.progress.say(text)

    def placed(self, path: str, up: str = "", **notes: object) -> ExportedFile:
        """Describe a file in the units of the options. up: y or z, or "" for their own axes."""
        return ExportedFile(path, up, file_from_scene(self.scene, self.config.units, up), notes)
