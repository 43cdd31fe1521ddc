"""Poses of Metashape, OpenSfM, Polycam and Record3D, written here after what those tools document, and of others that
are named, not read. Each case is a row of docs/import.md. See tests/stages/dots.py for how poses are measured."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import BadInput
from stages.pose_import import digest_of_source
from stages.readers import found_in, read_source
from tests.stages import dots
from tests.stages.dots import FOCAL, HEIGHT, WIDTH
from tests.stages.importing import Said, imported, scene_of
from tests.stages.table import rows_of
from tests.stylerf_cli.capture import quaternion, write_colmap

NAMES = [f"{index:03d}.png" for index in range(6)]
GL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])


def photos(root: Path, place="images", project=None) -> None:
    dots.write_photos(root / place, NAMES, project=project)


# -- Metashape ---------------------------------------------------------------------------------------------------------

PINHOLE = {"f": FOCAL}
BROWN = {
    "f": 150,
    "cx": 4,
    "cy": -3,
    "b1": 12,
    "b2": 0.3,
    "k1": -0.1,
    "k2": 0.05,
    "k3": -0.01,
    "p1": 0.012,
    "p2": -0.02,
}
FISHEYE = {"f": 150, "cx": 4, "cy": -3, "k1": 0.03, "k2": -0.02}


def metashape_pixels(c: dict, fisheye: bool):
    """Metashape's manual, appendix on camera models."""

    def project(inside: np.ndarray) -> np.ndarray:
        x, y = (inside[:, :2] / inside[:, 2:]).T
        if fisheye:
            r0 = np.hypot(x, y)
            x, y = x * np.arctan(r0) / r0, y * np.arctan(r0) / r0
        r2 = x * x + y * y
        n = 1 + c.get("k1", 0) * r2 + c.get("k2", 0) * r2**2 + c.get("k3", 0) * r2**3
        p1, p2 = c.get("p1", 0), c.get("p2", 0)
        xd = x * n + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y
        yd = y * n + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y
        u = WIDTH / 2 + c.get("cx", 0) + xd * (c["f"] + c.get("b1", 0)) + yd * c.get("b2", 0)
        return np.stack([u, HEIGHT / 2 + c.get("cy", 0) + yd * c["f"]], 1)

    return project


def metashape(
    root: Path, calibration=PINHOLE, kind="frame", labels=None, entry=lambda index: "", components="", component=None,
    moved=lambda index, pose: pose, head="", name="cameras.xml", wrap="{}",
) -> None:  # fmt: skip
    """Photos and cameras.xml; entry: further attributes of a camera; component: the one of each camera."""
    photos(root, project=metashape_pixels(calibration, kind == "fisheye"))
    numbers = "".join(f"<{key}>{value}</{key}>" for key, value in calibration.items())
    lines = []
    for index, pose in enumerate(dots.poses()):
        label = labels[index] if labels else NAMES[index][:3]
        belongs = f' component_id="{component(index)}"' if component else ""
        values = " ".join(map(repr, map(float, moved(index, pose).ravel())))
        transform = f"<transform>{values}</transform>" if "sensor" not in entry(index) else ""
        camera = f'<camera id="{index}" sensor_id="0" label="{label}"{belongs}{entry(index)}>{transform}</camera>'
        lines.append(wrap.format(camera))
    (root / name).write_text(
        f'<?xml version="1.0" encoding="UTF-8"?>\n{head}<document version="2.0.0"><chunk label="C" enabled="true">'
        f'<sensors next_id="1"><sensor id="0" type="{kind}"><resolution width="{WIDTH}" height="{HEIGHT}"/>'
        f'<calibration type="{kind}" class="initial"><f>1</f></calibration><calibration type="{kind}" class="adjusted">'
        f'<resolution width="{WIDTH}" height="{HEIGHT}"/>{numbers}</calibration></sensor></sensors>{components}'
        f'<cameras next_id="6">{"".join(lines)}</cameras></chunk></document>'
    )


TURN = dots.poses()[2][:3, :3]
SHIFT = np.array([100.0, -20.0, 7.0])


def joined(root: Path) -> None:
    """Cameras of two components, the second turned, moved and of another scale."""
    similarity = np.eye(4)
    similarity[:3] = np.column_stack([3 * TURN, SHIFT])

    def moved(index: int, pose: np.ndarray) -> np.ndarray:
        back = np.linalg.inv(similarity) @ pose
        back[:3, :3] *= 3
        return back if index % 2 else pose

    rotation, shift = (" ".join(map(repr, map(float, values.ravel()))) for values in (TURN, SHIFT))
    here = (
        "<transform><rotation>1 0 0 0 1 0 0 0 1</rotation><translation>0 0 0</translation><scale>1</scale></transform>"
    )
    there = f"<transform><rotation>{rotation}</rotation><translation>{shift}</translation><scale>3</scale></transform>"
    reported = f'<components><component id="0">{here}</component><component id="1">{there}</component></components>'
    metashape(root, components=reported, component=lambda index: index % 2, moved=moved)


def apart(root: Path) -> None:
    reported = '<components><component id="0"/><component id="1"/></components>'
    metashape(root, components=reported, component=lambda index: int(index == 5))


def some_cameras(root: Path) -> None:
    metashape(root, entry=lambda index: {1: ' enabled="false"', 3: ' master="no sensor"'}.get(index, ""))


def in_folders(root: Path) -> None:
    metashape(root, labels=NAMES)
    for name in NAMES[::2]:
        (root / "images/day 1").mkdir(exist_ok=True)
        (root / "images" / name).rename(root / "images/day 1" / name)


def bomb() -> str:
    levels = "".join(f'<!ENTITY e{n} "{f"&e{n - 1};" * 10}">' for n in range(1, 10))
    return f'<!DOCTYPE document [<!ENTITY e0 "0123456789">{levels}]>'


# -- OpenSfM -----------------------------------------------------------------------------------------------------------

OPENSFM = {
    "perspective": {"focal": 0.9, "k1": -0.1, "k2": 0.05},
    "simple_radial": {"focal_x": 0.9, "focal_y": 1.0, "c_x": 0.02, "c_y": -0.03, "k1": -0.1},
    "radial": {"focal_x": 0.9, "focal_y": 1.0, "c_x": 0.02, "c_y": -0.03, "k1": -0.1, "k2": 0.05},
    "brown": {"focal_x": 0.9, "focal_y": 1.0, "c_x": 0.02, "c_y": -0.03, "k1": -0.1, "k2": 0.05, "k3": -0.01,
              "p1": 0.01, "p2": -0.02},
    "fisheye": {"focal": 0.9, "k1": 0.03, "k2": -0.02},
    "fisheye_opencv": {"focal_x": 0.9, "focal_y": 1.0, "c_x": 0.02, "c_y": -0.03, "k1": 0.03, "k2": -0.02, "k3": 0.01},
}  # fmt: skip


def opensfm_pixels(kind: str, c: dict):
    """OpenSfM's doc/source/geometry.rst, and from its pixels, whose centers are whole numbers, to ours."""

    def project(inside: np.ndarray) -> np.ndarray:
        x, y = (inside[:, :2] / inside[:, 2:]).T
        if kind.startswith("fisheye"):
            r = np.hypot(x, y)
            x, y = x * np.arctan(r) / r, y * np.arctan(r) / r
        r2 = x * x + y * y
        d = 1 + c.get("k1", 0) * r2 + c.get("k2", 0) * r2**2 + c.get("k3", 0) * r2**3
        p1, p2 = c.get("p1", 0), c.get("p2", 0)
        u = c.get("focal_x", c.get("focal")) * (d * x + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + c.get("c_x", 0)
        v = c.get("focal_y", c.get("focal")) * (d * y + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)) + c.get("c_y", 0)
        return np.stack([u * max(WIDTH, HEIGHT) + (WIDTH - 1) / 2, v * max(WIDTH, HEIGHT) + (HEIGHT - 1) / 2], 1) + 0.5

    return project


def angle_axis(rotation: np.ndarray) -> list[float]:
    w, *axis = quaternion(rotation) * np.sign(quaternion(rotation)[0] or 1)
    length = np.linalg.norm(axis)
    return (np.array(axis) / length * 2 * np.arctan2(length, w)).tolist()


def shots(count: int = 6) -> dict:
    found = {}
    for name, pose in zip(NAMES[:count], dots.poses()):
        inverse = np.linalg.inv(pose)
        reported = {"rotation": angle_axis(inverse[:3, :3]), "translation": inverse[:3, 3].tolist()}
        found[name] = {**reported, "camera": "v2 phone"}
    return found


def opensfm(
    root: Path, kind="perspective", camera=None, place="reconstruction.json", also=(), change=lambda part: part
):
    camera = camera or OPENSFM[kind]
    photos(root, project=opensfm_pixels(kind, camera) if kind in OPENSFM else None)
    reported = {"projection_type": kind, "width": WIDTH, "height": HEIGHT, **camera}
    points = {str(n): {"coordinates": p.tolist(), "color": [250.0, 251, 252]} for n, p in enumerate(dots.POINTS)}
    part = change({"cameras": {"v2 phone": reported}, "shots": shots(), "points": points})
    (root / place).parent.mkdir(exist_ok=True)
    (root / place).write_text(json.dumps([*also, part]))


# -- Polycam and Record3D ----------------------------------------------------------------------------------------------


def polycam(root: Path, cameras="cameras", images="images", spoil=None) -> None:
    photos(root, f"keyframes/{images}")
    (root / "keyframes" / cameras).mkdir()
    for name, pose in zip(NAMES, dots.poses()):
        rows = pose @ GL_FROM_CV
        content = {f"t_{i}{j}": rows[i, j] for i in range(3) for j in range(4)}
        content |= {"fx": FOCAL, "fy": FOCAL, "cx": WIDTH / 2, "cy": HEIGHT / 2, "width": WIDTH, "height": HEIGHT}
        content |= {"blur_score": 100.0, "timestamp": 12345, **(spoil or {})}
        (root / "keyframes" / cameras / f"{name[:3]}.json").write_text(json.dumps(content))


def corrected(root: Path) -> None:
    """The optimized cameras beside those that were recorded, which are wrong."""
    polycam(root, "corrected_cameras", "corrected_images")
    (root / "keyframes/cameras").mkdir()
    dots.write_photos(root / "keyframes/images", NAMES, blank=True)
    (root / "keyframes/cameras/000.json").write_text("{}")


def record3d(root: Path, place="", pictures="rgb", name="metadata.json", each=False, **spoil) -> None:
    photos(root, Path(place) / pictures, project=lambda q: q[:, :2] / q[:, 2:] * [150, 160] + [84, 57])
    for index, photo in enumerate(NAMES):
        (root / place / pictures / photo).rename(root / place / pictures / f"{index}.png")
    poses = []
    for pose in dots.poses():
        w, x, y, z = quaternion((pose @ GL_FROM_CV)[:3, :3])
        poses.append([x, y, z, w, *pose[:3, 3]])
    k = [1, 0, 0, 0, 1, 0, 9, 9, 1] if each else [150, 0, 0, 0, 160, 0, 84, 57, 1]
    content = {"w": WIDTH, "h": HEIGHT, "fps": 60, "K": k, "poses": poses}
    if each:
        content["perFrameIntrinsicCoeffs"] = [[150, 160, 84, 57]] * 6
    (root / place / name).write_text(json.dumps(content | spoil))


READ = {
    "metashape": lambda root: metashape(root, BROWN),
    "metashape-fisheye": lambda root: metashape(root, FISHEYE, "fisheye"),
    "metashape-groups": lambda root: metashape(root, wrap='<group id="0" label="g">{}</group>', name="agisoft.xml"),
    "metashape-components": joined,
    "metashape-folders": in_folders,
    **{f"opensfm-{kind}": lambda root, kind=kind: opensfm(root, kind) for kind in OPENSFM},
    "opensfm-in-odm": lambda root: opensfm(root, place="opensfm/reconstruction.json"),
    "polycam": polycam,
    "polycam-corrected": corrected,
    "polycam-copied-by-macos": lambda root: (
        polycam(root),
        (root / "keyframes/cameras/._000.json").write_bytes(b"\0\5\26\7\xb0"),
    ),
    "record3d": record3d,
    "record3d-each-frame": lambda root: record3d(root, each=True),
    "record3d-exr": lambda root: record3d(root, "EXR_RGBD"),
    "record3d-unpacked": lambda root: record3d(root, pictures="rgbd", name="metadata"),
}


@pytest.mark.parametrize("row", READ)
def test_read(tmp_path, row):
    READ[row](tmp_path / "capture")
    made = imported(tmp_path / "capture", tmp_path / "work", test_every=0)
    assert len(scene_of(made).views) == 6 and dots.error(made) < 0.3
    assert made.manifest.figures["points"] == (30 if row.startswith("opensfm") else 0)


def test_a_file_of_poses_can_be_given(tmp_path):
    metashape(tmp_path / "capture", name="of Tuesday.xml")
    shutil.move(tmp_path / "capture/images/000.png", tmp_path / "capture/images/a.png")
    scene = scene_of(imported(tmp_path / "capture/of Tuesday.xml", tmp_path / "work", test_every=0))
    assert len(scene.views) == 5 and [one.source for one in scene.skipped] == ["000"]


def test_a_file_of_poses_counts(tmp_path):
    opensfm(tmp_path / "capture")
    before = digest_of_source(tmp_path / "capture")
    opensfm(tmp_path / "capture", camera={"focal": 0.95})
    assert digest_of_source(tmp_path / "capture") != before


SAID = {
    "metashape-apart": (apart, "2 components are not aligned with each other: the largest, of 5 photos, is used", 5),
    "metashape-not-aligned": (some_cameras, "", 4),
    "opensfm-several": (
        lambda root: opensfm(root, also=[{"cameras": {}, "shots": shots(2), "points": {}}]),
        "of 2 reconstructions the largest, of 6 photos, is used (others: 2)",
        6,
    ),
    "record3d-photos-missing": (
        lambda root: (record3d(root), (root / "rgb/2.png").unlink()),
        "1 of 6 frames have no photo",
        5,
    ),
}


@pytest.mark.parametrize("row", SAID)
def test_said(tmp_path, row):
    make, words, count = SAID[row]
    make(tmp_path / "capture")
    said = Said()
    made = imported(tmp_path / "capture", tmp_path / "work", said, test_every=0)
    assert len(scene_of(made).views) == count and dots.error(made) < 0.15
    assert any(words in line for line in said.lines), said.lines
    if row == "metashape-not-aligned":
        reasons = {one.source: one.reason for one in scene_of(made).skipped}
        assert reasons == {"001": "disabled in Metashape", "003": "not aligned by Metashape"}


REFUSED = {
    "metashape-document-type": (lambda root: metashape(root, head=bomb()), "it declares a document type"),
    "metashape-external-entity": (
        lambda root: metashape(root, head='<!DOCTYPE document SYSTEM "file:///etc/passwd">'),
        "it declares a document type",
    ),
    "metashape-skew": (lambda root: metashape(root, {"f": 150, "b2": 9}), "camera 000: its lens has skew (b2 9)"),
    "metashape-fisheye-tangential": (
        lambda root: metashape(root, {"f": 150, "p1": 0.1}, "fisheye"),
        "a fisheye with p1",
    ),
    "metashape-spherical": (lambda root: metashape(root, kind="spherical"), "its sensor is of type spherical"),
    "metashape-one-label": (
        lambda root: metashape(root, labels=["000", "000", *NAMES[2:]]),
        "two cameras are named '000'",
    ),
    "metashape-cut-short": (
        lambda root: (metashape(root), (root / "cameras.xml").write_text((root / "cameras.xml").read_text()[:900])),
        "is not a Metashape XML file",
    ),
    "metashape-other-xml": (
        lambda root: (photos(root), (root / "cameras.xml").write_text("x")),
        "is not a Metashape XML file",
    ),
    "opensfm-spherical": (
        lambda root: opensfm(root, "spherical", {"focal": 1}),
        "its projection spherical is not supported",
    ),
    "opensfm-other-json": (
        lambda root: (photos(root), (root / "reconstruction.json").write_text("{}")),
        "is not a list of OpenSfM reconstructions",
    ),
    "opensfm-camera-missing": (
        lambda root: opensfm(root, change=lambda part: part | {"cameras": {}}),
        "shot 000.png has camera v2 phone, which is missing",
    ),
    "polycam-other-json": (
        lambda root: polycam(root, spoil={"t_00": "x"}),
        "000.json: t_00: found 'x', expected a number",
    ),
    "record3d-too-few-poses": (
        lambda root: record3d(root, poses=[[0, 0, 0, 1, 0, 0, 0]] * 3),
        "has 3 poses, too few for",
    ),
    "record3d-no-rotation": (lambda root: record3d(root, poses=[[0] * 7] * 6), "pose 0: its quaternion has length 0"),
}


@pytest.mark.parametrize("row", REFUSED)
def test_refused(tmp_path, row):
    make, words = REFUSED[row]
    make(tmp_path / "capture")
    with pytest.raises(BadInput) as reported:
        imported(tmp_path / "capture", tmp_path / "work", test_every=0)
    assert words in str(reported.value) and "--format photos" in str(reported.value) and "\n" not in str(reported.value)


@pytest.mark.parametrize("count", [2, 6])
def test_points_of_opensfm_have_three_coordinates(tmp_path, count):
    points = {str(n): {"coordinates": [1.0] * count, "color": [1.0] * count} for n in range(3)}
    opensfm(tmp_path, change=lambda part: part | {"points": points})
    with pytest.raises(BadInput, match="a point has no coordinates or no color of three numbers"):
        read_source(tmp_path)


def test_a_resolution_of_metashape_with_thousands_of_digits_is_refused(tmp_path):
    metashape(tmp_path, BROWN)
    path = tmp_path / "cameras.xml"
    path.write_text(path.read_text().replace(f'width="{WIDTH}"', f'width="{"9" * 5000}"'))
    with pytest.raises(BadInput, match="its sensor has no resolution"):
        read_source(tmp_path)


def test_deeply_nested_xml_is_refused(tmp_path):
    metashape(tmp_path / "capture")
    (tmp_path / "capture/cameras.xml").write_text("<document>" * 300_000)
    with pytest.raises(BadInput, match="is not a Metashape XML file"):
        imported(tmp_path / "capture", tmp_path / "work")


NAMED = {
    "realitycapture-csv": ("any name.csv", b"#name,x,y,alt,heading,pitch,roll,f,px,py,k1\n", "RealityCapture"),
    "realitycapture-cameras.csv": ("cameras.csv", b"x", "RealityCapture"),
    "realitycapture-xmp": ("images/000.xmp", b'<x:xmpmeta><rdf xcr:Position="1 2 3"/>', "RealityCapture"),
    "realitycapture-project": ("scan.rcproj", b"<RealityCapture/>", "RealityCapture"),
    "meshroom-cameras.sfm": ("cameras.sfm", b"{}", "Meshroom"),
    "meshroom-project": ("scan.mg", b"{}", "Meshroom"),
    "metashape-project": ("scan.psx", b"<document/>", "Metashape"),
    "record3d-packed": ("scan.r3d", b"PK", "Record3D"),
    "openmvg": ("sfm_data.json", b"{}", "OpenMVG"),
    "visualsfm": ("scan.nvm", b"NVM_V3", "VisualSFM"),
    "bundler": ("bundle.out", b"# Bundle file v0.3", "Bundler"),
}


@pytest.mark.parametrize("row", NAMED)
def test_named(tmp_path, row):
    """Before structure from motion starts; beside poses that are read it is said; --format photos passes them over."""
    name, content, tool = NAMED[row]
    root = tmp_path / "capture"
    photos(root)
    (root / name).write_bytes(content)
    with pytest.raises(BadInput) as reported:
        imported(root, tmp_path / "work")
    line = str(reported.value)
    assert f"{name} contains poses of {tool}, which are not supported" in line and line.endswith("with --format photos")
    assert found_in(root, "photos").kind == "photos"
    write_colmap(root)
    assert found_in(root).kind == "colmap"
    assert found_in(root).remarks == (f"poses of {tool} are not supported ({Path(name).name})",)


@pytest.mark.parametrize("name", ["sidecar.xmp", "notes.csv", "layout.xml"])
def test_other_files_are_no_poses(tmp_path, name):
    photos(tmp_path)
    (tmp_path / name).write_text('<xmp darktable="1"/>, name, x, y')
    assert found_in(tmp_path).kind == "photos"


def test_every_row_of_the_docs_has_a_test():
    tested = [*READ, *SAID, *REFUSED, *NAMED]
    assert len(set(tested)) == len(tested) and rows_of("Poses of other tools") == set(tested)
