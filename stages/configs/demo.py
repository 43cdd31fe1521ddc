"""Options of `stylerf demo`."""

from dataclasses import dataclass

from stages.configs import option
from stages.configs.fit import budget_of


@dataclass(frozen=True)
class DemoConfig:
    """Size and duration of the demo."""

    size: int = option(200, help="side of the square photos, pixels")
    train_views: int = option(60, help="photos to train on")
    test_views: int = option(8, help="photos to test with")
    fit_budget: str = option("60s", help="training time of the field, or steps")
    style_budget: str = option("75s", help="time of the stylization, or steps")
    frames: int = option(36, help="frames of the video")
    method: str = option("desrf", choices=("arf", "desrf"), help="stylization method")

    def __post_init__(self) -> None:
        budget_of(self.fit_budget)
        budget_of(self.style_budget)
        if self.size < 32 or self.train_views < 4 or self.test_views < 1 or self.frames < 2:
            raise ValueError("the demo needs a size of at least 32, 4 training views, 1 test view and 2 frames")
