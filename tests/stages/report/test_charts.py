"""Charts: what they say of held-out views, and how they look inside a page."""

from stages.report.charts import bar_chart, curve_chart


def test_inlined_charts_take_the_text_color_of_the_page():
    chart = bar_chart("psnr_views", "PSNR", "dB", ["a"], [20.0])
    assert "currentColor" in chart.inline() and "currentColor" not in chart.svg
    assert "#24292f" not in chart.inline()


def test_a_curve_separates_held_out_from_trained_on():
    """Late in a fit, or always with few photos, the validation views join the training views (decision 0003)."""
    curve = [{"seconds": s, "psnr": 20 + s, "held_out": s < 3} for s in (1, 2, 3, 4)]
    chart = curve_chart("quality_seconds", "Quality", curve)
    assert "held out: 21.00 dB at 1 s to 22.00 dB at 2 s;" in chart.description
    assert "trained on: 23.00 dB at 3 s to 24.00 dB at 4 s" in chart.description
    assert "22.00 dB held out" in chart.svg and "24.00" not in chart.svg and "stroke-dasharray" in chart.svg
    alone = curve_chart("quality_seconds", "Quality", curve[2:])
    assert "24.00 dB trained on" in alone.svg and "held out" not in alone.svg + alone.description
