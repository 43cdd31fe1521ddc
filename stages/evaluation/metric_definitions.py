"""Every metric of a report: key, label, unit, direction, decimals and protocol. No other file defines one.

The order here is the order of the report. Labels and protocols are format strings; `Evaluation.facts` fills them in.
"""

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class MetricDefinition:
    """A metric of a report.

    Attributes:
        key: its name in report.json, in CSV headers and in manifests.
        better: "higher", "lower" or "" if neither is better.
        digits: decimals shown.
        protocol: how it is measured, so that values with the same protocol can be compared.
    """

    key: str
    label: str
    unit: str
    better: str
    digits: int
    protocol: str


_PHOTO = "against the photo {background}, sRGB values clipped to 0..1"
_DEPTH_PIXELS = "over the pixels of depth AbsRel"

LOCAL_EDIT = (
    MetricDefinition(
        "background_mse", "Background MSE", "", "lower", 6,
        f"Sum of m (render - photo)^2 over pixels and RGB, divided by 3 sum m, {_PHOTO}; m is 0 on pixels {{masked}} "
        "and 1 elsewhere. Mean over views.",
    ),
    MetricDefinition(
        "background_ratio", "Background MSE, ratio to the unedited field", "", "lower", 3,
        "Ratio of the mean to that of field {unedited}, over views that have both; median, min and max are of the "
        "ratios of single views.",
    ),
    MetricDefinition(
        "change_inside", "Change in the region", "", "", 4,
        "Mean |edited - unedited| over RGB (sRGB 0..1) between renders of this field and of field {unedited}, over "
        "the pixels {inside}; views that show the region.",
    ),
    MetricDefinition(
        "change_lab", "Change in the region, ΔE", "", "", 2,
        "Mean CIE76 color difference (D65; about 2.3 is just noticeable) to field {unedited}, over the same pixels.",
    ),
    MetricDefinition(
        "bleeding", "Bleeding", "", "lower", 4,
        "Mean |edited - unedited| over RGB to field {unedited}, in a ring of {ring} pixels around the region.",
    ),
    MetricDefinition(
        "sparsity", "Palette sparsity L_sp", "", "lower", 4,
        "Mean over {palette_pixels} of sum w / sum w^2 - 1 of the palette weights w (LAENeRF, supplement, eq. 2), "
        "on up to 10 training views, as recorded by {palette_source}.",
    ),
    MetricDefinition(
        "palette_variation", "Palette TV", "", "lower", 5,
        "Squared differences of the weights of neighbors among {palette_pixels}, times the alpha of both, summed over "
        "pairs and colors, divided by the number of pixels (as LAENeRF's released code); same views.",
    ),
    MetricDefinition(
        "region_share", "Region coverage", "fraction", "", 4, "Pixels {inside}, as a fraction of all of the view."
    ),
)  # fmt: skip

LOCAL_EDIT_TRAINING = tuple(
    replace(
        metric, key=f"train_{metric.key}", label=f"{metric.label}, training views",
        protocol=f"On training views. {metric.protocol}",
    )
    for metric in LOCAL_EDIT
    if metric.key not in ("sparsity", "palette_variation")
)  # fmt: skip

FIT = (
    MetricDefinition(
        "psnr", "PSNR", "dB", "higher", 2,
        f"-10 log10 of the mean squared error over pixels and RGB, {_PHOTO}. Mean over views. Equal images count as "
        "100 dB.",
    ),
    MetricDefinition(
        "psnr_object", "PSNR on the object", "dB", "higher", 2,
        "PSNR over the pixels where the photo's alpha is above 0.5, so that an empty background does not help.",
    ),
    MetricDefinition(
        "ssim", "SSIM", "", "higher", 4,
        "Gaussian window of 11x11 pixels, sigma 1.5, K 0.01 and 0.03, population covariance, data range 1; mean over "
        f"RGB and over pixels at least 5 from the border, {_PHOTO}.",
    ),
    MetricDefinition(
        "stlpips", "ST-LPIPS", "", "lower", 4, f"Shift-tolerant LPIPS ({{stlpips_net}}), whole image, {_PHOTO}."
    ),
    MetricDefinition("lpips", "LPIPS", "", "lower", 4, f"LPIPS v0.1 ({{lpips_net}}), whole image, {_PHOTO}."),
    MetricDefinition(
        "depth_abs_rel", "Depth AbsRel", "", "lower", 4,
        "Mean of |z - z*| / z* over pixels where the render's alpha is above 0.5 and the true planar depth z* is "
        "known; z is the depth of the rendered frame.",
    ),
    MetricDefinition(
        "depth_rmse", "Depth RMSE", "scene units", "lower", 4,
        f"Root mean squared error of planar depth, {_DEPTH_PIXELS}.",
    ),
    MetricDefinition(
        "depth_delta", "Depth δ < 1.25", "fraction", "higher", 4,
        f"Fraction with max(z/z*, z*/z) < 1.25, {_DEPTH_PIXELS}.",
    ),
    MetricDefinition(
        "depth_in_front", "Depth in front of the surface", "fraction", "lower", 4,
        f"Fraction whose depth is more than 10 % too small, {_DEPTH_PIXELS}: haze or floaters.",
    ),
    MetricDefinition(
        "depth_share", "Depth coverage", "fraction", "higher", 4,
        "Pixels whose depth was compared, as a fraction of all pixels with a known true depth.",
    ),
)  # fmt: skip

STYLE = (
    MetricDefinition(
        "nnfm", "NNFM distance to {style_label}", "", "lower", 4,
        "Mean of 1 - cosine between each feature of the render and its nearest in {style_label}; {style_protocol}.",
    ),
    MetricDefinition(
        "gram", "Gram distance to {style_label}", "", "lower", 4,
        "|G - G_s| / |G_s| of the Gram matrices of the render and {style_label}; features, sizes and weights as for "
        "NNFM.",
    ),
    MetricDefinition(
        "judge_gram", "Gram distance, {style_network}", "", "lower", 4,
        "|G - G_s| / |G_s| of the Gram matrices of {style_network}, weighted by alpha; network and sizes as for the "
        "SIFID-style distance.",
    ),
    MetricDefinition(
        "sifid", "SIFID-style distance, {style_network}", "", "lower", 3,
        "Squared Frechet distance between the features of {style_network} at the positions of the render and of "
        "{style_label}, sizes as for NNFM; a position counts once if more than half of it is opaque. The network is "
        "another one than the field was stylized with, unless it says so. SIFID proper uses Inception, so its values "
        "differ.",
    ),
    MetricDefinition(
        "palette", "Color distance to {style_label}", "", "lower", 4,
        "2-Wasserstein distance between the Gaussians with the mean and covariance of the sRGB colors of the render "
        "and {style_label}; pixels with alpha below 0.5 are left out. Color matching fits just these.",
    ),
    MetricDefinition(
        "palette_mean", "Color distance, means", "", "lower", 4,
        "Euclidean distance between the mean sRGB colors of the render and {style_label}, same pixels.",
    ),
    MetricDefinition(
        "palette_covariance", "Color distance, covariances", "", "lower", 4,
        "Frobenius norm of the difference between the covariances of sRGB colors, same pixels.",
    ),
    MetricDefinition(
        "colorfulness", "Colorfulness, ratio to {style_label}", "", "", 3,
        "Ratio of the render's colorfulness to that of {style_label}, same pixels: the spread of R - G and (R + G) / 2 "
        "- B, plus 0.3 times their mean, each as a length (Hasler and Suesstrunk 2003). 1 is as colorful; a gray wash "
        "is near 0.",
    ),
    MetricDefinition(
        "color_distribution", "Color distribution, distance to {style_label}", "ΔE", "lower", 2,
        "Sliced 2-Wasserstein distance of the colors of the render and {style_label} in CIELAB (D65), same pixels: the "
        "root mean square difference of 1024 quantiles along 16 axes, times sqrt(3), so that a shift of all colors by "
        "x has distance x.",
    ),
    MetricDefinition(
        "speckle", "Speckle beyond that of photo and {style_label}", "", "lower", 4,
        "Root mean square over pixels and RGB by which values lie outside the range of their 8 neighbors (sRGB 0..1), "
        "less the larger of those of the photo and of {style_label} at the render's size, at least 0; pixels with "
        "alpha below 0.5, and those beside them, are left out.",
    ),
    MetricDefinition(
        "content_ssim", "Content SSIM", "", "higher", 4,
        "SSIM (11x11, sigma 1.5) of Rec.709 luma between the stylized render and the photo {background}.",
    ),
    MetricDefinition(
        "edges_kept", "Edges of the photo kept", "fraction", "higher", 3,
        "Fraction of the photo's Canny edges (luma over its standard deviation, blurred by 0.4 % of the longer side) "
        "that have an edge of the render within 0.6 % of the longer side, of its orientation within 22 to 45 degrees, "
        "beyond what edges elsewhere would meet by chance; for an object, edges within its silhouette.",
    ),
    MetricDefinition(
        "ref_lpips", "Ref-{perceptual_net}", "", "lower", 4,
        "{perceptual_net} of whole images between the reference and the {nearest} test views with the cameras nearest "
        "to its own (Ref-NPR's metric, with this network); mean over views.",
    ),
    MetricDefinition(
        "robustness", "Robustness, PSNR", "dB", "higher", 2,
        "PSNR between the renders of this field and those of field {reference_field}, whose renders were its "
        "references (Ref-NPR); mean over views. Equal images count as 100 dB.",
    ),
    MetricDefinition(
        "shape_change", "Change of depth, AbsRel", "fraction", "", 4,
        "Mean of |z - z0| / z0 against the depth z0 of field {plain}, before stylization and deformation, where both "
        "are opaque; zero if the shape was kept.",
    ),
)  # fmt: skip

ALL_FIELDS = (
    MetricDefinition(
        "see_through", "Seen-through surface", "fraction", "lower", 4,
        "Fraction of a view's surface points that the previous view sees past: its depth there is more than 5 % "
        "behind them. Floaters cause this, and to a small degree silhouettes.",
    ),
)  # fmt: skip


def _means(pair_range: str) -> tuple[str, str]:
    """How many pairs a mean is over: of the error, and of the perceptual distance, which is slower."""
    return f"mean of {{{pair_range}_pairs}} pairs", f"mean of {{{pair_range}_perceptual_pairs}} pairs"


def _correct(pair_range: str, target: str) -> tuple[MetricDefinition, ...]:
    """The project's own protocol, with a visibility test; for a local edit also within its region."""
    consistency, (mean, perceptual_mean) = f"{pair_range.capitalize()}-range consistency", _means(pair_range)
    name = f"{consistency} (correct)"
    warped = f"Frame k of {{path}} warped onto frame {target} {{warp_protocol}}"
    return (
        MetricDefinition(
            f"{pair_range}_rmse", f"{name}, RMSE", "", "lower", 4,
            f"{warped}; root mean squared error over visible pixels and RGB; {mean}.",
        ),
        MetricDefinition(
            f"edit_{pair_range}_rmse", f"{consistency} within the region (correct), RMSE", "", "lower", 4,
            f"{warped}; root mean squared error over RGB and the visible pixels of the target {{inside}}; mean of the "
            "pairs whose target shows the region.",
        ),
        MetricDefinition(
            f"edit_{pair_range}_share", f"{consistency} within the region (correct), visible", "fraction", "", 4,
            f"{warped}; visible pixels as a fraction of the target's opaque pixels {{inside}}; same pairs.",
        ),
        MetricDefinition(
            f"{pair_range}_perceptual", f"{name}, {{perceptual_net}}", "", "lower", 4,
            f"{warped}; {{perceptual_net}} per pixel, averaged over visible pixels; elsewhere both images show the "
            f"target and add nothing; {perceptual_mean}.",
        ),
        MetricDefinition(
            f"{pair_range}_share", f"{name}, visible", "fraction", "", 4,
            f"{warped}; visible pixels as a fraction of the opaque pixels of the target; {mean}.",
        ),
    )  # fmt: skip


def _laenerf_script(pair_range: str, target: str) -> tuple[MetricDefinition, ...]:
    """The protocol of LAENeRF's released script."""
    name = f"{pair_range.capitalize()}-range consistency (laenerf-script)"
    mean, perceptual_mean = _means(pair_range)
    return (
        MetricDefinition(
            f"{pair_range}_laenerf_script_mse", f"{name}, MSE", "", "lower", 4,
            f"LAENeRF's released script, bugs included: frame k of {{path}} sampled along the flow of frame {target}; "
            f"squared difference summed over RGB, mean over the pixels that its check flags; {mean}, of those "
            "with any. The check adds the forward flow to itself. {flow}; missing flow counts as 0. The script uses "
            "RAFT flow of the unstylized video, and all of its pairs.",
        ),
        MetricDefinition(
            f"{pair_range}_laenerf_script_perceptual", f"{name}, {{perceptual_net}}", "", "lower", 4,
            f"{{perceptual_net}} of the same two whole images of {{path}}, given in 0..1 where -1..1 is expected; "
            f"{perceptual_mean}. The script uses LPIPS on AlexNet.",
        ),
        MetricDefinition(
            f"{pair_range}_laenerf_script_flagged", f"{name}, flagged", "fraction", "", 4,
            f"Pixels that the script's check flags, over which it averages; {mean}.",
        ),
    )  # fmt: skip


def _stylerf_family(pair_range: str, target: str) -> tuple[MetricDefinition, ...]:
    """StyleRF's protocol."""
    name = f"{pair_range.capitalize()}-range consistency (stylerf-family)"
    mean, perceptual_mean = _means(pair_range)
    return (
        MetricDefinition(
            f"{pair_range}_stylerf_family_rmse", f"{name}, RMSE", "", "lower", 4,
            f"Frame k of {{path}} moved onto frame {target} by softmax splatting (importance -20 times the color "
            f"difference); root mean squared error over RGB and the pixels that receive a splat; {mean}. {{flow}}. "
            "Papers use RAFT flow, and pairs of their own.",
        ),
        MetricDefinition(
            f"{pair_range}_stylerf_family_perceptual", f"{name}, {{perceptual_net}}", "", "lower", 4,
            "{perceptual_net} per pixel of the same pairs of {path}, averaged over the pixels that receive a splat; "
            f"elsewhere both images show the target; {perceptual_mean}.",
        ),
        MetricDefinition(
            f"{pair_range}_stylerf_family_share", f"{name}, reached", "fraction", "", 4,
            f"Pixels that receive a splat; {mean}.",
        ),
    )  # fmt: skip


CAMERA_PATH = tuple(
    metric
    for protocol in (_correct, _laenerf_script, _stylerf_family)
    for pair_range, target in {"short": "k+1", "long": "k+{gap}"}.items()
    for metric in protocol(pair_range, target)
)

DEFINITIONS: tuple[MetricDefinition, ...] = (
    *LOCAL_EDIT, *LOCAL_EDIT_TRAINING, *FIT, *STYLE, *ALL_FIELDS, *CAMERA_PATH
)  # fmt: skip
BY_KEY: dict[str, MetricDefinition] = {metric.key: metric for metric in DEFINITIONS}
