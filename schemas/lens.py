"""The lens of a photo as stored in scene.json and frames.json."""

from dataclasses import dataclass, fields
from typing import Any

from schemas.json_numbers import FOCAL_LENGTHS, number, numbers, whole

OTHER_KINDS = ("fov", "division", "eucm", "thin_prism_fisheye", "rad_tan_thin_prism_fisheye")
KINDS = ("brown", "fisheye", *OTHER_KINDS)
MOST_COEFFICIENTS = 12
LARGEST_COEFFICIENT = 1e6
LARGEST_PHOTO_SIDE = 1 << 20  # pixels; photos may be larger than the pictures that are made of them


@dataclass(frozen=True)
class LensDistortion:
    """Distortion of normalized image coordinates; geometry/distortion.py has the formulas.

    Attributes:
        kind: brown (OpenCV's), fisheye (Kannala-Brandt), or one of OTHER_KINDS.
        radial, denominator: Coefficients of the polynomials of r^2 (brown) or theta^2 (fisheye, radial only).
        tangential: p1, p2.
        others: Parameters of OTHER_KINDS, in COLMAP's order.
    """

    kind: str = "brown"
    radial: tuple[float, ...] = ()
    tangential: tuple[float, ...] = (0.0, 0.0)
    denominator: tuple[float, ...] = ()
    others: tuple[float, ...] = ()


@dataclass(frozen=True)
class Lens:
    """A photo, upright: its size, its intrinsics in pixels, and the distortion that import has removed."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: LensDistortion


def lens_of(entry: Any, where: str) -> Lens | None:
    """Check an entry of scene.json, null for none; ValueError, TypeError or KeyError where it is not sound."""
    if entry is None:
        return None
    _known_only(entry, Lens)
    width, height = (whole(entry[key], f"{where}: {key}", 1, LARGEST_PHOTO_SIDE) for key in ("width", "height"))
    fx, fy = (number(entry[key], f"{where}: {key}", *FOCAL_LENGTHS) for key in ("fx", "fy"))
    cx, cy = (number(entry[key], f"{where}: {key}") for key in ("cx", "cy"))
    return Lens(width, height, fx, fy, cx, cy, distortion_of(entry["distortion"], where))


def distortion_of(entry: Any, where: str) -> LensDistortion:
    """Check the distortion of a lens; ValueError, TypeError or KeyError where it is not sound."""
    _known_only(entry, LensDistortion)
    if entry["kind"] not in KINDS:
        raise ValueError(f"{where}: kind is not one of {', '.join(KINDS)}")
    lists = {key: _coefficients(entry[key], f"{where}: {key}") for key in ("radial", "tangential", "denominator")}
    if len(lists["tangential"]) != 2:
        raise ValueError(f"{where}: tangential has {len(lists['tangential'])} numbers, expected 2")
    return LensDistortion(entry["kind"], **lists, others=_coefficients(entry.get("others", ()), f"{where}: others"))


def _coefficients(values: Any, what: str) -> tuple[float, ...]:
    if not isinstance(values, (list, tuple)) or len(values) > MOST_COEFFICIENTS:
        raise ValueError(f"{what} is not a list of at most {MOST_COEFFICIENTS} numbers")
    return numbers(values, what, len(values), -LARGEST_COEFFICIENT, LARGEST_COEFFICIENT)


def _known_only(entry: Any, kind: type[Lens | LensDistortion]) -> None:
    if not isinstance(entry, dict):
        raise ValueError(f"a {kind.__name__} is not an object")
    if unknown := sorted(entry.keys() - {item.name for item in fields(kind)}):
        raise ValueError(f"unknown fields {', '.join(unknown)} in a {kind.__name__}")
