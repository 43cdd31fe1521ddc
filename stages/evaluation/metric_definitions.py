"""Which figures there are: what each is called, which way is better, and by which protocol it is measured."""

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class MetricDefinition:
    """A kind of figure. better: "higher", "lower" or "". label and protocol take the run's facts by str.format."""

    key: str
    label: str
    unit: str
    better: str
    digits: int
    protocol: str


_PHOTO = "against the photo {background}, sRGB values clipped to 0..1"
_SAME_PIXELS = "over the pixels of the relative depth error"

EDITED = (
    MetricDefinition(
        "background_mse", "Background MSE", "", "lower", 6,
        f"Sum of m (render - photo)^2 over pixels and RGB by 3 sum m, {_PHOTO}; m is 0 on pixels {{masked}} and 1 "
        "elsewhere. Mean of the views' values.",
    ),
    MetricDefinition(
        "background_ratio", "Background MSE over that of the unedited field", "", "lower", 3,
        "Ratio to the mean of field {unedited}, over the views that have both; median, lowest and highest are of the "
        "ratios of single views.",
    ),
    MetricDefinition(
        "change_inside", "Change in the region", "", "", 4,
        "Mean |edited - unedited| of the renders of this field and of field {unedited} over RGB (sRGB values 0..1) and "
        "over the pixels {inside}; views that show the region.",
    ),
    MetricDefinition(
        "change_lab", "Change in the region, CIELAB", "", "", 2,
        "Mean CIE76 color difference (D65; about 2.3 is just seen) to field {unedited} over the same pixels.",
    ),
    MetricDefinition(
        "bleeding", "Change beside the region", "", "lower", 4,
        "Mean difference to field {unedited} over RGB in a ring of {ring} pixels around what counts as the region: an "
        "edit that runs over its edge.",
    ),
    MetricDefinition(
        "sparsity", "Palette sparsity L_sp", "", "lower", 4,
        "Mean over {palette_pixels} of sum w / sum w^2 - 1 of the palette's weights w (LAENeRF, supplement, eq. 2), "
        "on up to 10 training views, as told by {palette_teller}.",
    ),
    MetricDefinition(
        "palette_variation", "Palette TV", "", "lower", 5,
        "Differences of the weights of neighbors among {palette_pixels}, times the alpha of both, squared and summed "
        "over pairs and colors, over the number of pixels (as LAENeRF's released code); same views.",
    ),
    MetricDefinition("region_share", "Region in view", "share", "", 4, "Pixels {inside}, over all pixels of the view."),
)  # fmt: skip

EDITED_TRAINING = tuple(
    replace(
        kind, key=f"train_{kind.key}", label=f"{kind.label}, training views",
        protocol=f"On training views. {kind.protocol}",
    )
    for kind in EDITED
    if kind.key not in ("sparsity", "palette_variation")
)  # fmt: skip

FITTED = (
    MetricDefinition(
        "psnr", "PSNR", "dB", "higher", 2,
        f"-10 log10 of the mean squared error over pixels and RGB, {_PHOTO}. Mean of the views' values. Equal images "
        "count as 100 dB.",
    ),
    MetricDefinition(
        "psnr_object", "PSNR on the object", "dB", "higher", 2,
        "As PSNR, over the pixels where the photo's alpha is over 0.5, so that an empty background does not help.",
    ),
    MetricDefinition(
        "ssim", "SSIM", "", "higher", 4,
        "Gaussian window of 11x11 pixels, sigma 1.5, K 0.01 and 0.03, population covariance, data range 1, mean over "
        f"RGB and over pixels 5 or more from the border, {_PHOTO}.",
    ),
    MetricDefinition(
        "stlpips", "ST-LPIPS", "", "lower", 4, f"Shift-tolerant LPIPS ({{stlpips_net}}), whole image, {_PHOTO}."
    ),
    MetricDefinition("lpips", "LPIPS", "", "lower", 4, f"LPIPS v0.1 ({{lpips_net}}), whole image, {_PHOTO}."),
    MetricDefinition(
        "depth_abs_rel", "Depth error, relative", "", "lower", 4,
        "Mean of |z - z*| / z* over pixels where the render's alpha is over 0.5 and the true planar depth z* is "
        "known; z is that of the rendered frame.",
    ),
    MetricDefinition(
        "depth_rmse", "Depth error, RMS", "scene units", "lower", 4,
        f"Root of the mean squared difference of planar depth {_SAME_PIXELS}.",
    ),
    MetricDefinition(
        "depth_delta", "Depth within 25 %", "share", "higher", 4,
        f"Share with max(z/z*, z*/z) < 1.25 {_SAME_PIXELS}.",
    ),
    MetricDefinition(
        "depth_in_front", "Depth short of the surface", "share", "lower", 4,
        f"Share whose depth falls short of the truth by more than a tenth, {_SAME_PIXELS}: haze or floaters.",
    ),
    MetricDefinition(
        "depth_share", "Depth compared", "share", "higher", 4,
        "Pixels whose depth was compared, over all pixels with a known true depth.",
    ),
)  # fmt: skip

STYLIZED = (
    MetricDefinition(
        "nnfm", "NNFM distance to {style_words}", "", "lower", 4,
        "Mean of 1 - cosine between each feature of the render and its nearest in {style_words}; {style_protocol}.",
    ),
    MetricDefinition(
        "gram", "Gram distance to {style_words}", "", "lower", 4,
        "|G - G_s| / |G_s| of the Gram matrices of the render and {style_words}; features, sizes and weights as for "
        "NNFM.",
    ),
    MetricDefinition(
        "sifid", "SIFID-style distance, {style_trunk}", "", "lower", 3,
        "Squared Frechet distance between the features of conv2_2 of {style_trunk} at the positions of the render and "
        "{style_words}, sizes as for NNFM, each position counted once where over half of it is opaque. SIFID itself "
        "looks through Inception: its values are others.",
    ),
    MetricDefinition(
        "palette", "Palette distance to {style_words}", "", "lower", 4,
        "2-Wasserstein distance between the Gaussians that have the mean and covariance of the sRGB colors of the "
        "render and {style_words}; pixels with alpha under 0.5 are left out.",
    ),
    MetricDefinition(
        "palette_mean", "Difference of mean color", "", "lower", 4,
        "Euclidean distance between the mean sRGB colors of the render and {style_words}, same pixels.",
    ),
    MetricDefinition(
        "palette_covariance", "Difference of color covariance", "", "lower", 4,
        "Frobenius norm of the difference between the covariances of sRGB colors, same pixels.",
    ),
    MetricDefinition(
        "content_ssim", "Content SSIM", "", "higher", 4,
        "SSIM (11x11, sigma 1.5) of Rec.709 luma between the stylized render and the photo {background}.",
    ),
    MetricDefinition(
        "ref_lpips", "Ref-{perceptual_net}", "", "lower", 4,
        "{perceptual_net} of whole images between the reference picture and the {nearest} test views whose cameras are "
        "nearest to its view's (Ref-NPR's measure with this network); mean of the views.",
    ),
    MetricDefinition(
        "robustness", "Robustness, PSNR", "dB", "higher", 2,
        "PSNR between the renders of this field and those of field {twin}, whose renders were this one's references "
        "(Ref-NPR); mean of the views. Equal images count as 100 dB.",
    ),
    MetricDefinition(
        "shape_change", "Change of depth", "share", "", 4,
        "Mean of |z - z0| / z0 against the depth z0 of field {plain}, from before stylization and deformation, where "
        "both are opaque: zero where the shape was kept.",
    ),
)  # fmt: skip

SHARED = (
    MetricDefinition(
        "see_through", "Seen through", "share", "lower", 4,
        "Share of a view's surface points that the view before it looks past, whose depth there lies more than 5 % "
        "behind them. Floaters count, and to a small degree silhouettes.",
    ),
)  # fmt: skip


def _means(label: str) -> tuple[str, str]:
    """How many pairs of a range a figure is the mean of; and a perceptual distance, the slowest."""
    return f"mean of {{{label}_pairs}} pairs", f"mean of {{{label}_looked_at}} pairs"


def _correct(label: str, words: str) -> tuple[MetricDefinition, ...]:
    """Our own, of one range; of a local edit also within its region."""
    name, (mean, looked_at) = f"Consistency {label} (correct)", _means(label)
    warped = f"Frame k of {{path}} warped onto frame {words} {{warp_protocol}}"
    return (
        MetricDefinition(
            f"{label}_rmse", f"{name}, RMSE", "", "lower", 4,
            f"{warped}; root mean square over visible pixels and RGB; {mean}.",
        ),
        MetricDefinition(
            f"edit_{label}_rmse", f"Consistency {label} within the region (correct), RMSE", "", "lower", 4,
            f"{warped}; root mean square over RGB and the visible pixels of the target {{inside}}; {mean}.",
        ),
        MetricDefinition(
            f"{label}_perceptual", f"{name}, {{perceptual_net}}", "", "lower", 4,
            f"{warped}; {{perceptual_net}} per pixel, averaged over visible pixels; elsewhere both images show the "
            f"target, so nothing counts; {looked_at}.",
        ),
        MetricDefinition(
            f"{label}_share", f"{name}, visible", "share", "", 4,
            f"{warped}; visible pixels over opaque pixels of the target; {mean}.",
        ),
    )  # fmt: skip


def _script(label: str, words: str) -> tuple[MetricDefinition, ...]:
    """LAENeRF's released script, of one range."""
    name, (mean, looked_at) = f"Consistency {label} (laenerf-script)", _means(label)
    return (
        MetricDefinition(
            f"{label}_laenerf_script_mse", f"{name}, MSE", "", "lower", 4,
            f"As LAENeRF's released script, faults included: frame k of {{path}} read along the flow of frame {words}; "
            f"squared difference summed over RGB, mean over the pixels that its check flags; {mean}, those that have "
            "any. The check adds the forward flow to itself. {flow}; where there is none, it is taken as 0. The "
            "script takes RAFT's flow of the unstylized film, and all pairs of it.",
        ),
        MetricDefinition(
            f"{label}_laenerf_script_perceptual", f"{name}, {{perceptual_net}}", "", "lower", 4,
            f"{{perceptual_net}} of the same two whole images of {{path}}, given 0..1 where -1..1 is expected; "
            f"{looked_at}. The script takes LPIPS on AlexNet.",
        ),
        MetricDefinition(
            f"{label}_laenerf_script_flagged", f"{name}, flagged", "share", "", 4,
            f"Pixels that its check flags, which are those it averages over; {mean}.",
        ),
    )  # fmt: skip


def _family(label: str, words: str) -> tuple[MetricDefinition, ...]:
    """StyleRF's protocol, of one range."""
    name, (mean, looked_at) = f"Consistency {label} (stylerf-family)", _means(label)
    return (
        MetricDefinition(
            f"{label}_stylerf_family_rmse", f"{name}, RMSE", "", "lower", 4,
            f"Frame k of {{path}} moved onto frame {words} by softmax splatting (importance -20 times the difference "
            f"of colors); root mean square over RGB and the pixels that anything lands on; {mean}. {{flow}}. Papers "
            "take RAFT's flow, and pairs of their own.",
        ),
        MetricDefinition(
            f"{label}_stylerf_family_perceptual", f"{name}, {{perceptual_net}}", "", "lower", 4,
            "{perceptual_net} per pixel of the same pairs of {path}, averaged over the pixels that anything lands on; "
            f"elsewhere both images show the target; {looked_at}.",
        ),
        MetricDefinition(
            f"{label}_stylerf_family_share", f"{name}, reached", "share", "", 4,
            f"Pixels that anything lands on; {mean}.",
        ),
    )  # fmt: skip


_RANGES = {"short": "k+1", "long": "k+{gap}"}
FILMED = tuple(kind for maker in (_correct, _script, _family) for some in _RANGES.items() for kind in maker(*some))

KINDS: tuple[MetricDefinition, ...] = (*EDITED, *EDITED_TRAINING, *FITTED, *STYLIZED, *SHARED, *FILMED)
BY_KEY: dict[str, MetricDefinition] = {kind.key: kind for kind in KINDS}
