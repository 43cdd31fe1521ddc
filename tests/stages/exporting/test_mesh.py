"""Exported meshes and shots, read back by other libraries: where things are, which way is up, what colors they have."""

import json
import sys
from dataclasses import replace

import numpy as np
import pygltflib
import pytest
import trimesh

from schemas.errors import BadInput, OutOfResources
from schemas.images import linear_from_srgb
from schemas.scene import read_scene, write_scene
from schemas.work_folder import Artifact, Recipe, WorkFolder
from stages.artifacts.camera_files import read_cameras
from stages.artifacts.field import save_field
from stages.artifacts.scene import load_scene
from stages.configs.export import ExportConfig
from stages.exporting import libraries
from stylerf.geometry.scene_normalization import rotation_between, similarity
from stylerf.geometry.space_warp import SpaceWarp
from tests.stages.evaluation_fixture import commit
from tests.stages.exporting.fixture import exported
from tests.stages.stress_fixture import make_capture
from tests.stylerf.surfaces.fields import ball, solid

CENTER = np.array([0.1, -0.2, 0.3])
SMALL = {"kind": "mesh", "resolution": 40, "faces": 2000}
# The source's up is z, a little tilted; its units are a tenth of the scene's.
SCENE_FROM_SOURCE = similarity(10.0, rotation_between(np.array([0.1, 0, 1]) / np.hypot(0.1, 1), np.array([0, 0, 1.0])),
                               np.array([5.0, 6.0, 7.0]))  # fmt: skip


@pytest.fixture(scope="module")
def inputs(tmp_path_factory) -> dict[str, Artifact]:
    """A ball of radius 0.5 about CENTER, scene units, seen from a dome of cameras."""
    work = WorkFolder(tmp_path_factory.mktemp("export") / "work")
    plain = make_capture(work)
    content = read_scene(plain.path)
    begun = work.begin("scene", "main", Recipe("pose_import", 1, {"moved": True}, []))
    for view in content.views:
        (begun.path / view.image).parent.mkdir(exist_ok=True)
        (begun.path / view.image).write_bytes((plain.path / view.image).read_bytes())
    near_by = replace(content.bounds, far=1.0)  # as those of a capture, which shows more than its bounds
    matrix = tuple(map(tuple, SCENE_FROM_SOURCE.tolist()))
    write_scene(begun.path, replace(content, scene_from_source=matrix, bounds=near_by))
    scene = begun.commit()
    field = solid(lambda points: ball(points - CENTER), SpaceWarp.box([-1, -1, -1], [1, 1, 1]))
    made = commit(work, "field", "fit", "nerf_fit", {"scene": scene}, lambda at: save_field(at, field, "white"))
    return {"scene": scene, "field": made}


@pytest.fixture(scope="module")
def made(inputs, tmp_path_factory):
    return exported(tmp_path_factory.mktemp("made"), inputs, formats="glb,obj,ply", **SMALL)


def middle(vertices) -> np.ndarray:
    return (np.min(vertices, axis=0) + np.max(vertices, axis=0)) / 2


def read_glb(path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions, normals, colors and faces by pygltflib."""
    gltf = pygltflib.GLTF2().load(str(path))
    blob, out = gltf.binary_blob(), []
    for accessor in gltf.accessors:
        view = gltf.bufferViews[accessor.bufferView]
        kind = np.float32 if accessor.componentType == pygltflib.FLOAT else np.uint32
        data = np.frombuffer(blob[view.byteOffset : view.byteOffset + view.byteLength], kind)
        out.append(data.reshape(-1, 3))
    return tuple(out)


def test_ply_lies_in_the_sources_own_coordinates(made):
    mesh = trimesh.load(made.path / "mesh.ply", process=False)
    source = np.linalg.inv(SCENE_FROM_SOURCE)
    np.testing.assert_allclose(middle(mesh.vertices), source[:3, :3] @ CENTER + source[:3, 3], atol=0.002)
    assert mesh.extents == pytest.approx([0.1] * 3, abs=0.005)
    assert 1000 < len(mesh.faces) <= 2000
    outward = (mesh.face_normals * (mesh.triangles_center - middle(mesh.vertices))).sum(1)
    assert outward.min() > 0


def test_glb_and_obj_have_y_up(made):
    """z of the source becomes y, and y becomes -z."""
    ply = trimesh.load(made.path / "mesh.ply", process=False).vertices
    positions, normals, _, faces = read_glb(made.path / "mesh.glb")
    np.testing.assert_allclose(positions, ply[:, [0, 2, 1]] * [1, 1, -1], atol=1e-5)
    assert (normals * (positions - middle(positions))).sum(1).min() > 0
    obj = trimesh.load(made.path / "mesh.obj", process=False, maintain_order=True)
    np.testing.assert_allclose(middle(obj.vertices), middle(positions), atol=1e-4)
    assert len(obj.faces) == len(faces)


def test_colors_are_linear_in_glb_and_srgb_in_ply(made):
    *_, colors, _ = read_glb(made.path / "mesh.glb")
    ply = trimesh.load(made.path / "mesh.ply", process=False).visual.vertex_colors[:, :3] / 255
    np.testing.assert_allclose(colors, linear_from_srgb(ply), atol=0.01)
    lines = (made.path / "mesh.obj").read_text().splitlines()
    obj = np.array([line.split()[4:] for line in lines if line.startswith("v ")], float)
    np.testing.assert_allclose(obj, ply, atol=0.003)
    assert np.ptp(ply, axis=0).min() > 0.3  # red, green and blue grow along the scene's axes


def test_export_json_leads_back_to_the_scene(made):
    content = json.loads((made.path / "export.json").read_text())
    assert {one["path"] for one in content["files"]} == {"mesh.glb", "mesh.obj", "mesh.ply"}
    for one in content["files"]:
        matrix = np.linalg.inv(one["file_from_scene"])
        vertices = trimesh.load(made.path / one["path"], force="mesh", process=False).vertices
        np.testing.assert_allclose(matrix[:3, :3] @ middle(vertices) + matrix[:3, 3], CENTER, atol=0.03)


def test_all_faces_and_scene_units(inputs, tmp_path):
    one = exported(tmp_path, inputs, formats="ply", units="scene", **{**SMALL, "faces": 0})
    mesh = trimesh.load(one.path / "mesh.ply", process=False)
    np.testing.assert_allclose(middle(mesh.vertices), CENTER, atol=0.02)  # no camera sees its bottom
    assert one.manifest.figures["faces"] == len(mesh.faces) > 2000


def test_the_same_export_has_the_same_bytes(inputs, made, tmp_path):
    assert exported(tmp_path, inputs, formats="glb,obj,ply", **SMALL).manifest.files == made.manifest.files


def complaints(path) -> list[str]:
    """What usdchecker says of a file: by the validators of usd-core 26, or the checker of those before."""
    from pxr import Usd, UsdUtils

    if hasattr(UsdUtils, "ComplianceChecker"):
        checker = UsdUtils.ComplianceChecker(arkit=False, skipARKitRootLayerCheck=True)
        checker.CheckCompliance(str(path))
        return [*checker.GetErrors(), *checker.GetFailedChecks(), *checker.GetWarnings()]
    from pxr import UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 10
    errors = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(path)))
    return [one.GetMessage() for one in errors]


def test_the_checker_complains_of_a_file_without_an_up_axis(tmp_path):
    (tmp_path / "bare.usda").write_text('#usda 1.0\n\ndef Xform "a"\n{\n}\n')
    assert complaints(tmp_path / "bare.usda")


@pytest.mark.parametrize("format", ["usda", "usdc"])
def test_a_shot_holds_camera_and_mesh_and_complies(inputs, made, tmp_path, format):
    from pxr import Usd, UsdGeom

    options = {"count": 4, "fps": 25.0, "meters_per_unit": 0.01, "formats": format}
    shot = exported(tmp_path, inputs, **{**SMALL, **options, "kind": "shot"})
    path = shot.path / f"shot.{format}"
    assert complaints(path) == []
    stage = Usd.Stage.Open(str(path))
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Y", 0.01)
    assert (stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (25, 1, 4)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/shot/mesh"))
    positions, *_ = read_glb(made.path / "mesh.glb")
    np.testing.assert_allclose(np.array(mesh.GetPointsAttr().Get()), positions, atol=1e-5)
    near, far = np.array(UsdGeom.Camera(stage.GetPrimAtPath("/shot/camera")).GetClippingRangeAttr().Get()) * 10
    # The camera looks at the ball: it comes back as one of the scene's orbit.
    for camera in read_cameras(path, load_scene(inputs["scene"])).cameras:
        assert (camera.center - CENTER) @ camera.forward < 0
        pixel, depth = camera.project(CENTER[None])
        assert near < depth - 0.5 and depth + 0.5 < far < depth + 3
        assert depth > 0 and 0 < pixel[0, 0] < camera.width and 0 < pixel[0, 1] < camera.height


def test_a_shot_of_splats_holds_the_splats_of_the_field_where_its_mesh_is(inputs, made, tmp_path):
    from pxr import Usd, UsdVol

    if not hasattr(UsdVol, "ParticleField3DGaussianSplat"):
        pytest.skip("the installed OpenUSD has no prim for splats")
    shot = exported(
        tmp_path, inputs, kind="shot", geometry="splats", count=4, formats="usda", splats=2000, budget="2"
    )
    path = shot.path / "shot.usda"
    assert complaints(path) == []
    assert (shot.path / "splats.ply").read_bytes().startswith(b"ply")  # for what does not know the prim
    stage = Usd.Stage.Open(str(path))
    assert not stage.GetPrimAtPath("/shot/mesh")
    centers = np.array(UsdVol.ParticleField3DGaussianSplat.Get(stage, "/shot/splats").GetPositionsAttr().Get())
    assert len(centers) == shot.manifest.figures["splats"] > 500
    surface, *_ = read_glb(made.path / "mesh.glb")
    np.testing.assert_allclose(np.median(centers, 0), np.median(surface, 0), atol=0.1 * np.ptp(surface))
    assert len(read_cameras(path, load_scene(inputs["scene"])).cameras) == 4


def far_from_its_origin(scene: Artifact, work: WorkFolder) -> Artifact:
    """The scene with the source coordinates of a map: UTM, in meters; the ball is 0.1 wide."""
    content = read_scene(scene.path)
    matrix = SCENE_FROM_SOURCE @ similarity(1.0, np.eye(3), -np.array([500000.0, 4649776.0, 100.0]))
    begun = work.begin("scene", "main", Recipe("pose_import", 1, {"far": True}, []))
    for view in content.views:
        (begun.path / view.image).parent.mkdir(exist_ok=True)
        (begun.path / view.image).write_bytes((scene.path / view.image).read_bytes())
    write_scene(begun.path, replace(content, scene_from_source=tuple(map(tuple, matrix.tolist()))))
    return begun.commit()


@pytest.mark.parametrize("options", [SMALL, {"kind": "splats", "splats": 500, "budget": "1"}])
def test_coordinates_that_float32_would_blur_are_refused(inputs, tmp_path, options):
    far = inputs | {"scene": far_from_its_origin(inputs["scene"], WorkFolder(tmp_path / "work"))}
    with pytest.raises(BadInput, match=r"reach 4\.65e\+06, .* are 0\.5 apart, too .*; export with --units scene"):
        exported(tmp_path / "made", far, formats="ply", **options)
    exported(tmp_path / "made", far, formats="ply", units="scene", **options)


def test_a_field_of_nothing_is_refused(inputs, tmp_path):
    work = WorkFolder(tmp_path / "work")
    field = solid(lambda points: np.full(len(points), 9.0), SpaceWarp.box([-1, -1, -1], [1, 1, 1]), 16)
    empty = commit(work, "field", "fog", "nerf_fit", {}, lambda at: save_field(at, field, "white"))
    with pytest.raises(BadInput, match="field fog: no ray of the training views ends at a surface"):
        exported(tmp_path / "made", {**inputs, "field": empty}, **SMALL)
    assert not (tmp_path / "made/export/made").exists()


def test_a_missing_library_is_named_with_the_command_that_installs_it(inputs, tmp_path, monkeypatch):
    monkeypatch.setitem(libraries.OF_FORMATS, "glb", "pygltflib_that_is_not_there")
    monkeypatch.setitem(libraries.PACKAGES, "pygltflib_that_is_not_there", "pygltflib")
    with pytest.raises(OutOfResources, match=r"--format glb needs pygltflib.*pip install 'stylerf\[export\]'"):
        exported(tmp_path, inputs, **SMALL)


def test_a_mesh_without_the_library_for_fewer_triangles_says_what_to_do(inputs, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "fast_simplification", None)
    with pytest.raises(OutOfResources, match=r"at most 2,000 triangles \(--faces 0: of all\) needs fast-simplif.*pip"):
        exported(tmp_path, inputs, **SMALL, formats="ply")
    exported(tmp_path, inputs, **SMALL | {"faces": 0}, formats="ply")


@pytest.mark.parametrize(
    "options",
    [
        {"formats": "usdc"}, {"formats": "glb,glb"}, {"path": "orbit"}, {"fps": 25.0}, {"photos": False},
        {"kind": "cameras", "faces": 500}, {"kind": "cameras", "count": 9}, {"kind": "cameras", "reach": 2.0},
        {"kind": "cameras", "formats": "chan", "photos": False}, {"kind": "cameras", "meters_per_unit": 0.1},
        {"faces": 3}, {"resolution": 4096}, {"reach": 1.0}, {"kind": "shot", "photos": False}, {"geometry": "splats"},
        {"kind": "shot", "splats": 500}, {"kind": "shot", "geometry": "splats", "faces": 500},
    ],
)  # fmt: skip
def test_options_that_make_no_sense_are_refused(options):
    with pytest.raises(ValueError):
        ExportConfig(**options)
