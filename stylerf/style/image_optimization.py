"""A picture alone, painted by optimizing its pixels (Gatys et al. 2016), a step at a time."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

FIRST, SECOND, FLOOR = 0.9, 0.99, 1e-8  # decays of Adam's moments, and what is added to the root of the second

Loss = Callable[[Tensor], tuple[Tensor, dict[str, float]]]


class ImageOptimization:
    """Straight colors that learn by Adam; what is seen is alpha colors + (1 - alpha) background.

    start: [3, h, w] over the background, sRGB 0..1. alpha: [h, w], None where all is covered. background: a level of
    gray, or a picture [3, h, w] of which only a part is painted. Adam moves every color
    by about `rate` a step, however small its gradient: where the coverage is small, so is what is seen of that.
    """

    def __init__(self, start: Tensor, alpha: Tensor | None, background: float | Tensor, rate: float) -> None:
        self.alpha, self.background, self.rate = alpha, background, rate
        straight = start if alpha is None else (start - (1 - alpha) * self.background) / alpha.clamp_min(1e-3)
        self.colors = straight.detach().clamp(0, 1).clone()
        self.first, self.second, self.steps = torch.zeros_like(start), torch.zeros_like(start), 0

    def seen(self, colors: Tensor | None = None) -> Tensor:
        """[3, h, w] over the background."""
        colors = self.colors if colors is None else colors
        return colors if self.alpha is None else self.alpha * colors + (1 - self.alpha) * self.background

    def step(self, loss: Loss, factor: float = 1.0) -> dict[str, float]:
        """One step with `factor` of the rate; the parts of the loss before it. Colors stay in 0..1."""
        colors = self.colors.clone().requires_grad_()
        total, parts = loss(self.seen(colors))
        (gradient,) = torch.autograd.grad(total, colors)
        self.steps += 1
        self.first.mul_(FIRST).add_(gradient, alpha=1 - FIRST)
        self.second.mul_(SECOND).addcmul_(gradient, gradient, value=1 - SECOND)
        size = (self.second / (1 - SECOND**self.steps)).sqrt_() + FLOOR
        self.colors.addcdiv_(self.first, size, value=-self.rate * factor / (1 - FIRST**self.steps)).clamp_(0, 1)
        return parts

    def pixels(self) -> np.ndarray:
        """[h, w, 3] float32 over the background."""
        return np.ascontiguousarray(self.seen().permute(1, 2, 0).cpu().numpy())

    def arrays(self) -> dict[str, np.ndarray]:
        """What a checkpoint needs."""
        moments = {"colors": self.colors, "first": self.first, "second": self.second}
        return {k: v.cpu().numpy().copy() for k, v in moments.items()} | {"steps": np.asarray([self.steps])}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """From arrays()."""
        for name in ("colors", "first", "second"):
            getattr(self, name).copy_(torch.from_numpy(arrays[name]))
        self.steps = int(arrays["steps"][0])


def painted(
    start: Tensor,
    alpha: Tensor | None,
    background: float | Tensor,
    loss: Loss,
    steps: int,
    rate: float,
    enough: Callable[[], bool] = lambda: False,
) -> tuple[np.ndarray, dict[str, float]]:
    """(picture [h, w, 3] float32, the loss's parts before the last step) after so many steps whose size falls to 0.

    enough: asked after every step, whether that was the last; one is made in any case.
    """
    made = ImageOptimization(start, alpha, background, rate)
    for at in range(steps):
        parts = made.step(loss, 1 - at / steps)
        if enough():
            break
    return made.pixels(), parts
