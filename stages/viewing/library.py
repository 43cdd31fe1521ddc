"""The fields, regions and palettes of a work folder, loaded on demand."""

from collections import OrderedDict
from pathlib import Path

import numpy as np

from schemas.errors import ArtifactStale, StylerfError, UsageError
from schemas.work_folder import Artifact, WorkFolder, newest, sources_of
from stages.artifacts.field import load_field
from stages.artifacts.photos import level_of
from stages.artifacts.region import load_region, regions_fitting
from stages.artifacts.scene import SceneData, load_scene
from stages.viewing.shown import Source
from stylerf.editing.edit_grid import Region
from stylerf.fields.palette_color import PaletteColor

KEPT_FIELDS = 4  # in memory
OWN_FOLDER = "view"  # in the work folder: paths, style images and scripts that the viewer writes


class Library:
    """The contents of a work folder. Artifacts are listed again each time, since other commands may add some."""

    def __init__(self, root: Path | str) -> None:
        """Open the folder.

        Raises:
            UsageError: it is a file or does not exist.
            ArtifactStale: it contains no scene or no field.
        """
        self.work = WorkFolder(root)
        if not self.work.root.is_dir():
            raise UsageError(f"{self.work.root} not found; expected a work folder")
        photos = [one for one in self.work.artifacts("scene") if one.manifest.stage != "distill"]
        self.scene: SceneData = load_scene(photos[0] if photos else self.work.get("scene", "main"))
        self._loaded: OrderedDict[str, Source] = OrderedDict()
        if not self.fields():
            raise ArtifactStale(f"no field in {self.work.root}; make one with: stylerf fit {self.work.root}")

    @property
    def own(self) -> Path:
        """The folder for files that the viewer itself writes."""
        return self.work.root / OWN_FOLDER

    def fields(self) -> list[str]:
        """Return the names of the fields, newest first; unreadable ones are left out."""
        readable = []
        for one in self.work.artifacts("field"):
            try:
                _ = one.manifest
            except StylerfError:
                continue
            readable.append(one)
        return [one.name for one in newest(readable)]

    def first_field(self) -> str:
        """Return the field to show first: the newest."""
        return self.fields()[0]

    def source(self, name: str) -> Source:
        """Return a field, from memory if it has not been rebuilt."""
        artifact = self.work.get("field", name)
        key = artifact.digest
        if key not in self._loaded:
            field, background = load_field(artifact)
            self._loaded[key] = Source(name, field, level_of(background))
        self._loaded.move_to_end(key)
        while len(self._loaded) > KEPT_FIELDS:
            self._loaded.popitem(last=False)
        return self._loaded[key]

    def splats(self, field: str) -> Path | None:
        """Return the newest exported PLY of a field's splats in scene units; None without one."""
        wanted = self.work.get("field", field).digest
        for one in newest(self.work.artifacts("export")):
            made_of = {ref.digest for ref in one.manifest.inputs if ref.kind == "field"}
            files = [record.path for record in one.manifest.files if record.path.endswith(".ply")]
            if wanted in made_of and one.manifest.config.get("kind") == "splats" and files:
                if one.manifest.config.get("units") == "scene":
                    return one.file(files[0])
        return None

    def regions(self, field: str) -> list[str]:
        """Return the names of the regions selected in the space of a field."""
        fitting, _ = regions_fitting(self.work, self.work.get("field", field))
        return [one.name for one in fitting.values()]

    def region(self, name: str) -> Region:
        """Return a region's cells."""
        return load_region(self.work.get("region", name))[0]

    def marked(self, name: str) -> np.ndarray:
        """Return the marked cells of a region, [s, s, s] bool."""
        return self.region(name).edit

    def palettes(self) -> list[str]:
        """Return what can be recolored: decomposed fields, and edits of regions as "edit NAME"."""
        found = []
        for name in self.fields():
            artifact = self.work.get("field", name)
            if artifact.has("palette.json") and isinstance(self.source(name).field.color, PaletteColor):
                found.append(name)
        return found

    def edits(self) -> list[str]:
        """Return the names of regions' palettes."""
        return [one.name for one in self.work.artifacts("edit") if one.manifest.stage == "edit_learn"]

    def all_edits(self) -> list[str]:
        """Return the names of all edits, newest first; these can be distilled."""
        return [one.name for one in newest(self.work.artifacts("edit"))]

    def region_of_edit(self, edit: Artifact) -> Artifact | None:
        """Return the region of an edit; None if it no longer exists."""
        return next((one for one in sources_of(edit) if one.kind == "region"), None)
