"""Every format of splats, read back by another reader than its writer."""

import gzip
import struct

import numpy as np
import pytest

from schemas.errors import BadInput
from stages.configs.export import ExportConfig
from stages.exporting import splat_files
from stylerf.kernels.cpu.splats import Gaussians


def splats(bands: int = 4, count: int = 50) -> Gaussians:
    generator = np.random.default_rng(0)
    quaternions = generator.normal(size=(count, 4))
    arrays = (
        generator.uniform(-2, 2, (count, 3)), generator.uniform(-6, -1, (count, 3)),
        quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True), generator.normal(0, 2, count),
        generator.normal(0, 0.3, (count, bands, 3)),
    )  # fmt: skip
    return Gaussians(*(values.astype(np.float32) for values in arrays))


@pytest.mark.parametrize("bands", [1, 4, 9])
def test_ply_has_the_same_numbers_for_gsply(bands, tmp_path):
    gsply, written = pytest.importorskip("gsply"), splats(bands)
    splat_files.write_ply(tmp_path / "s.ply", written)
    read = gsply.plyread(tmp_path / "s.ply")
    found = read.means, read.scales, read.quats, read.opacities, read.sh0
    expected = (*written[:4], written.harmonics[:, 0])
    for a, b in zip(found, expected, strict=True):
        assert np.array_equal(np.asarray(a), b)
    if bands > 1:
        assert np.array_equal(np.asarray(read.shN), written.harmonics[:, 1:])


def test_ply_of_degree_0_has_the_color_that_viewers_compute(tmp_path):
    one = splats(1, 1)
    splat_files.write_ply(tmp_path / "s.ply", one)
    header, body = (tmp_path / "s.ply").read_bytes().split(b"end_header\n")
    names = [line.split()[-1].decode() for line in header.splitlines() if line.startswith(b"property float")]
    numbers = dict(zip(names, np.frombuffer(body, "<f4"), strict=True))
    assert b"format binary_little_endian 1.0" in header and b"element vertex 1" in header
    assert [numbers[f"f_dc_{k}"] for k in range(3)] == one.harmonics[0, 0].tolist()
    assert [numbers[f"rot_{k}"] for k in range(4)] == one.quaternions[0].tolist()
    assert not any(numbers[name] for name in ("nx", "ny", "nz"))


def test_spz_has_the_same_numbers_within_its_steps(tmp_path):
    pytest.importorskip("gsply")
    written = splats(1)
    bits = splat_files.write_spz(tmp_path / "s.spz", written)
    # Niantic's layout: header, then positions (24 bits), opacities, colors, scales (8 bits), rotations (version 3).
    data = gzip.decompress((tmp_path / "s.spz").read_bytes())
    magic, version, n, degree, fraction = struct.unpack_from("<4sIIBB", data)
    assert (magic, version, n, degree, fraction) == (b"NGSP", 3, 50, 0, bits)
    rows = np.frombuffer(data, np.uint8, n * 19, 16)
    digits = rows[: 9 * n].reshape(n, 3, 3).astype(np.int32)
    fixed = (digits[..., 0] | digits[..., 1] << 8 | digits[..., 2] << 16) << 8 >> 8
    np.testing.assert_allclose(fixed / 2.0**fraction, written.centers, atol=2.0**-fraction)
    opacities = rows[9 * n : 10 * n] / 255
    np.testing.assert_allclose(opacities, 1 / (1 + np.exp(-written.logits)), atol=1 / 255)
    colors = (rows[10 * n : 13 * n].reshape(n, 3) / 255 - 0.5) / 0.15
    np.testing.assert_allclose(colors, written.harmonics[:, 0], atol=1 / 255 / 0.15)
    scales = rows[13 * n : 16 * n].reshape(n, 3) / 16 - 10
    np.testing.assert_allclose(scales, written.log_scales, atol=1 / 16)


def test_spz_gives_up_precision_for_reach_and_refuses_what_does_not_fit(tmp_path):
    pytest.importorskip("gsply")
    far = splats(1)._replace(centers=splats(1).centers * np.float32(1e4))
    assert splat_files.write_spz(tmp_path / "s.spz", far) < 12
    beyond = far._replace(centers=far.centers * np.float32(1e4))
    with pytest.raises(BadInput, match="--units scene"):
        splat_files.write_spz(tmp_path / "t.spz", beyond)


@pytest.mark.parametrize("size", [1e-3, 1.0, 500.0])
def test_spz_holds_small_and_large_splats_or_says_what_it_loses(tmp_path, size):
    gsply, one = pytest.importorskip("gsply"), splats(1)
    log_scales = one.log_scales + np.float32(np.log(size))
    written = one._replace(centers=one.centers * np.float32(size), log_scales=log_scales)
    bits = splat_files.write_spz(tmp_path / "s.spz", written)
    read = gsply.read_spz(tmp_path / "s.spz")
    errors = np.abs(np.asarray(read.means) - written.centers).max()
    assert errors < 0.1 * np.median(np.exp(log_scales.max(1))), bits
    clamped = (np.abs(np.asarray(read.scales) - log_scales) > 1 / 31).any(1).sum()
    said = splat_files.lost_in_spz(written, bits)
    assert said.startswith(f"{clamped} of 50 splats are smaller") if clamped else said == ""
    assert bool(clamped) == (size == 1e-3)
    assert "positions are rounded to steps of 0.5" in splat_files.lost_in_spz(one, 1)


def test_glb_has_the_same_numbers_for_pygltflib(tmp_path):
    pygltflib, written = pytest.importorskip("pygltflib"), splats(4)
    splat_files.write_glb(tmp_path / "s.glb", written)
    read = pygltflib.GLTF2().load(tmp_path / "s.glb")
    blob, primitive = read.binary_blob(), read.meshes[0].primitives[0]
    assert read.extensionsUsed == ["KHR_gaussian_splatting"] and primitive.mode == pygltflib.POINTS
    look = primitive.extensions["KHR_gaussian_splatting"]
    assert (look["kernel"], look["colorSpace"]) == ("ellipse", "srgb_rec709_display")

    def values(name: str) -> np.ndarray:
        accessor = read.accessors[getattr(primitive.attributes, name)]
        view = read.bufferViews[accessor.bufferView]
        return np.frombuffer(blob, "<f4", view.byteLength // 4, view.byteOffset).reshape(accessor.count, -1)

    own = "KHR_gaussian_splatting:"
    assert np.array_equal(values("POSITION"), written.centers)
    np.testing.assert_allclose(values(own + "SCALE"), np.exp(written.log_scales), rtol=1e-6)
    np.testing.assert_allclose(values(own + "OPACITY")[:, 0], 1 / (1 + np.exp(-written.logits)), rtol=1e-6)
    assert np.array_equal(values(own + "ROTATION"), written.quaternions[:, [1, 2, 3, 0]])
    for band, name in enumerate(["0_COEF_0", "1_COEF_0", "1_COEF_1", "1_COEF_2"]):
        assert np.array_equal(values(f"{own}SH_DEGREE_{name}"), written.harmonics[:, band])
    assert read.accessors[0].min == written.centers.min(0).tolist()
    assert values("COLOR_0").min() >= 0 and values("COLOR_0").max() <= 1


@pytest.mark.parametrize("name", ["s.usda", "s.usdc"])
def test_usd_has_the_same_numbers(name, tmp_path):
    volumes, usd = pytest.importorskip("pxr.UsdVol"), pytest.importorskip("pxr.Usd")
    if not hasattr(volumes, "ParticleField3DGaussianSplat"):
        pytest.skip("OpenUSD before 26.03")
    written = splats(4)
    splat_files.write_usd(tmp_path / name, written, ExportConfig(kind="splats", formats="usda"))
    stage = usd.Stage.Open(str(tmp_path / name))
    prim = volumes.ParticleField3DGaussianSplat(stage.GetPrimAtPath("/shot/splats"))
    close = {"rtol": 1e-6, "atol": 1e-6}
    np.testing.assert_allclose(prim.GetPositionsAttr().Get(), written.centers, **close)
    np.testing.assert_allclose(prim.GetScalesAttr().Get(), np.exp(written.log_scales), **close)
    np.testing.assert_allclose(prim.GetOpacitiesAttr().Get(), 1 / (1 + np.exp(-written.logits)), **close)
    found = [(q.GetReal(), *q.GetImaginary()) for q in prim.GetOrientationsAttr().Get()]
    np.testing.assert_allclose(found, written.quaternions, **close)
    assert prim.GetRadianceSphericalHarmonicsDegreeAttr().Get() == 1
    coefficients = np.array(prim.GetRadianceSphericalHarmonicsCoefficientsAttr().Get())
    np.testing.assert_allclose(coefficients.reshape(50, 4, 3), written.harmonics, **close)
