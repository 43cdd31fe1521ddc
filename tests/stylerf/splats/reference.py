"""3D Gaussian splatting written out in torch, float64: every pixel against every Gaussian (Kerbl et al. 2023)."""

import numpy as np
import torch

from stylerf.geometry.camera_paths import look_at
from stylerf.geometry.cameras import Camera
from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.kernels.cpu.splats import Gaussians


def camera(center=(0.3, -2.2, 0.5), width=45, height=37) -> Camera:
    pose = look_at(np.array(center, float), np.zeros(3), np.array([0, 0, 1.0]))
    return Camera("view", width, height, 40.0, 42.0, 20.0, 19.0, pose)


def random_gaussians(count: int, bands: int, seed: int = 0) -> Gaussians:
    generator = np.random.default_rng(seed)
    arrays = (
        generator.uniform(-1, 1, (count, 3)),
        generator.uniform(-3.5, -0.8, (count, 3)),
        generator.normal(size=(count, 4)),
        generator.normal(0, 3, count),
        generator.normal(0, 0.5, (count, bands, 3)),
    )
    return Gaussians(*(values.astype(np.float32) for values in arrays))


def splatted(parameters: list[torch.Tensor], camera: Camera, near: float) -> torch.Tensor:
    """[h, w, 4]: premultiplied rgb and alpha; differentiable, but for colors that turn with the centers."""
    centers, log_scales, quaternions, logits, coefficients = parameters
    pose = torch.tensor(np.linalg.inv(camera.world_from_camera))
    turn = pose[:3, :3]
    local = centers @ turn.T + pose[:3, 3]
    z = local[:, 2]
    sides = ((camera.width, camera.fx, camera.cx), (camera.height, camera.fy, camera.cy))
    u, v = (
        (local[:, axis] / z).clamp((-0.15 * side - middle) / focal, (1.15 * side - middle) / focal)
        for axis, (side, focal, middle) in enumerate(sides)
    )
    zero = torch.zeros_like(z)
    across = torch.stack([camera.fx / z, zero, -camera.fx * u / z], -1)
    jacobian = torch.stack([across, torch.stack([zero, camera.fy / z, -camera.fy * v / z], -1)], 1)
    axes = _rotations(quaternions) * log_scales.exp()[:, None, :]
    covariance = jacobian @ turn @ axes @ axes.transpose(1, 2) @ turn.T @ jacobian.transpose(1, 2)
    inverse = torch.linalg.inv(covariance + 0.3 * torch.eye(2, dtype=torch.float64))
    middles = torch.stack([camera.fx * local[:, 0] / z + camera.cx, camera.fy * local[:, 1] / z + camera.cy], -1)
    directions = centers.detach().numpy() - camera.center
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    basis = torch.tensor(harmonics(directions, round(coefficients.shape[1] ** 0.5) - 1)).double()
    colors = (0.5 + (basis[:, :, None] * coefficients).sum(1)).clamp(min=0)
    down, right = torch.meshgrid(torch.arange(camera.height) + 0.5, torch.arange(camera.width) + 0.5, indexing="ij")
    pixels = torch.stack([right, down], -1).double()
    left, rgb = torch.ones(pixels.shape[:2], dtype=torch.float64), torch.zeros(*pixels.shape[:2], 3).double()
    for i in torch.argsort(z, stable=True).tolist():
        if z[i] <= near:
            continue
        away = pixels - middles[i]
        alpha = (torch.sigmoid(logits[i]) * (-0.5 * (away @ inverse[i] * away).sum(-1)).exp()).clamp(max=0.99)
        alpha = torch.where((alpha >= 1 / 255) & (left >= 1e-4), alpha, 0 * alpha)
        rgb = rgb + (left * alpha)[..., None] * colors[i]
        left = left * (1 - alpha)
    return torch.cat([rgb, 1 - left[..., None]], -1)


def _rotations(quaternions: torch.Tensor) -> torch.Tensor:
    w, x, y, z = (quaternions / quaternions.norm(dim=-1, keepdim=True)).T
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, -1).reshape(-1, 3, 3)
