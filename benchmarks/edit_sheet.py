"""Local edits before and after: `python -m benchmarks.edit_sheet WORK OUT.png REGION VIEW,VIEW EDIT...`.

One row per view: the photo, the photo with the region highlighted, the original field, and each edited field. The
frames of the test views must exist (`stylerf eval WORK --of EDIT --region REGION` renders them).
"""

import sys
from pathlib import Path

import numpy as np
from skimage.transform import resize

from schemas.exr import read_channels
from schemas.frames import read_frames
from schemas.images import read_image, to_uint8, write_png
from schemas.work_folder import Artifact, WorkFolder
from stages.artifacts.scene import load_scene

SIDE = 300  # pixels, an image's longer side
GAP = 6
MARGIN = 8  # rows of white background kept above and below
TINT = np.array([1.0, 0.1, 0.8])


def picture(frames: Artifact, name: str) -> np.ndarray:
    """Return a frame over the scene's background, [h, w, 3]."""
    frame = next(one for one in read_frames(frames.path).views if one.name == name)
    return read_image(frames.file(frame.png)).pixels[..., :3]


def region_over(frames: Artifact, name: str, region: str, photo: np.ndarray) -> np.ndarray:
    """Return the photo, tinted where a frame's EXR shows the region."""
    found = read_frames(frames.path)
    frame = next(one for one in found.views if one.name == name)
    channel = f"mask.{found.masks[region]}"
    mask = read_channels(frames.file(frame.exr), (channel,))[0][channel].astype(np.float64)[..., None]
    return photo * (1 - 0.6 * mask) + 0.6 * mask * TINT


def small(image: np.ndarray) -> np.ndarray:
    """Return the image scaled to a longer side of SIDE pixels."""
    scale = SIDE / max(image.shape[:2])
    return resize(image, (round(image.shape[0] * scale), round(image.shape[1] * scale), 3), anti_aliasing=scale < 1)


def main() -> None:
    root, out, region, views, *edits = sys.argv[1:]
    work = WorkFolder(Path(root))
    scene = load_scene(next(one for one in work.artifacts("scene") if one.manifest.stage == "pose_import"))
    field = next(ref.name for ref in work.get("region", region).manifest.inputs if ref.kind == "field")
    rows = []
    for name in views.split(","):
        view = next(i for i, one in enumerate(scene.views) if one.name == name)
        photo = scene.images(view)
        photo = photo[..., :3] if photo.shape[2] == 3 else photo[..., :3] * photo[..., 3:] + 1 - photo[..., 3:]
        of = {one: work.get("frames", f"{one}-test") for one in (field, *edits)}
        row = [photo, region_over(of[edits[0]], name, region, photo)]
        row += [picture(frames, name) for frames in of.values()]
        shown = np.flatnonzero((photo < 0.97).any((1, 2)))
        kept = slice(max(int(shown[0]) - MARGIN, 0), int(shown[-1]) + MARGIN) if len(shown) else slice(None)
        cells = [small(one[kept]) for one in row]
        gap = np.ones((cells[0].shape[0], GAP, 3))
        rows.append(np.concatenate([part for cell in cells for part in (cell, gap)][:-1], 1))
    gap = np.ones((GAP, rows[0].shape[1], 3))
    sheet = np.concatenate([part for row in rows for part in (row, gap)][:-1], 0)
    write_png(Path(out), to_uint8(np.clip(sheet, 0, 1)))


if __name__ == "__main__":
    main()
