"""Numbers as pages show them."""

from schemas.safe_names import listed
from stages.report.formatting import clock, count, duration, megabytes, number


def test_numbers_in_words():
    assert (number(-1.5, 1), number(None, 2), number(float("nan"), 2)) == ("−1.5", "–", "–")
    assert (duration(59.96), duration(245), duration(3725), duration(None)) == ("60.0 s", "4 min 5 s", "1 h 2 min", "–")
    assert (clock(12.34), clock(245), clock(3725)) == (("12.3", "s"), ("4:05", "min"), ("1:02", "h"))
    assert (megabytes(1500), megabytes(5e6, 1e6)) == ("1.50 GB", "5.0 MB")
    assert (count(950), count(12_345), count(4.56e6)) == ("950", "12.3 thousand", "4.56 million")
    assert listed(list("abcdefgh"), 3) == "a, b, c and 5 more"
