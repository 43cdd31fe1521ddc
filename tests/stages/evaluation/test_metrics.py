"""Summaries of values over views."""

from stages.evaluation.metrics import is_number, summarize


def test_summaries_leave_out_and_count_missing_values():
    rows = [{"psnr": 20.0}, {"psnr": None}, {"psnr": 30.0}, {"psnr": float("nan")}, {"ssim": None}]
    (figure,) = summarize(rows, {})
    assert (figure.mean, figure.median, figure.min, figure.max) == (25, 25, 20, 30)
    assert (figure.count, figure.left_out) == (2, 2)


def test_integers_beyond_floats_are_no_numbers_to_show():
    assert is_number(10**300) and not is_number(10**400) and not is_number(float("inf")) and not is_number(True)
