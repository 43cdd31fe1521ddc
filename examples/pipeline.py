"""From photos and a style image to a stylized scene, a video and a report, in Python.

    python examples/pipeline.py PHOTOS STYLE_IMAGE WORK [FIT_BUDGET [STYLE_BUDGET]]

PHOTOS is a folder of photos, alone or with camera poses. Budgets are times (60s, 5m) or numbers of steps. Rerun it to
resume after an interruption: whatever is up to date in WORK is reused.
"""

import sys

from stages.configs.fit import FitConfig
from stages.configs.render import RenderConfig
from stages.configs.stylize import ArfConfig
from stages.pipeline.pipeline import Pipeline
from stylerf_cli.progress import Bars


def main(photos: str, style_image: str, work: str, fit_budget: str = "5m", style_budget: str = "2m") -> str:
    """Run the pipeline; return the path of the report."""
    pipeline = Pipeline(work, seed=0, progress=Bars(sys.stderr))
    pipeline.import_photos(photos)
    field = pipeline.fit(FitConfig(budget=fit_budget))
    stylized = pipeline.stylize(ArfConfig(style=style_image, budget=style_budget), of=field)
    pipeline.render(RenderConfig(path="orbit", count=48, video=True), of=stylized)
    report = pipeline.evaluate(of=stylized)
    return str(report.file("report.html"))


if __name__ == "__main__":
    print(main(*sys.argv[1:]))
