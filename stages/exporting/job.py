"""The inputs of an export, and the description of the files that it writes."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from schemas.errors import BadInput
from schemas.work_folder import Artifact
from stages.artifacts.field import load_field
from stages.artifacts.scene import SceneData, load_scene
from stages.artifacts.world_axes import applied, file_from_scene, scale_of
from stages.configs.export import ExportConfig
from stages.run.progress import Context
from stylerf.fields.radiance_field import RadianceField

COARSEST_STEP = 0.1  # precision of 32-bit coordinates, relative to the size of what they place


@dataclass(frozen=True, eq=False)
class ExportedFile:
    """One file of an export.

    Attributes:
        path: inside the artifact, with forward slashes.
        up: axis that is up in it, y or z; "" for unchanged axes.
        file_from_scene: [4, 4] similarity from scene units to its coordinates.
        notes: conventions that the format does not define, by name.
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
        """The field as it is rendered: deformed and edited."""
        return load_field(self.inputs["field"])[0]

    def say(self, text: str) -> None:
        """Show the user one line."""
        self.context.progress.say(text)

    def placed(self, path: str, up: str = "", **notes: object) -> ExportedFile:
        """Describe a file in the units of the options. up: y or z, or "" for unchanged axes."""
        return ExportedFile(path, up, file_from_scene(self.scene, self.config.units, up), notes)

    def check_precision(self, points: np.ndarray, sizes: np.ndarray) -> None:
        """Raise BadInput if files, whose coordinates are float32, would blur most of what is exported.

        Source coordinates may be far from their origin, such as those of a map.

        Args:
            points: [n, 3], scene units.
            sizes: [n], of the splats or faces at these points, scene units.
        """
        matrix = file_from_scene(self.scene, self.config.units)
        reach = np.abs(applied(matrix, points.astype(np.float64))).max(1)
        steps, sizes = np.spacing(reach.astype(np.float32)), sizes * scale_of(matrix)
        if np.mean(steps > COARSEST_STEP * sizes) > 0.5:
            raise BadInput(
                f"{self.scene.folder}: its source coordinates reach {reach.max():.3g}, where the 32-bit floats of "
                f"exported files are {steps.max():.2g} apart, too coarse for details of {np.median(sizes):.2g}; "
                "export with --units scene"
            )
