import pytest

from schemas import safe_names
from schemas.errors import ArtifactDamaged, BadInput
from schemas.safe_names import file_name, printable, relative_path


@pytest.mark.parametrize(
    "text", ["a.png", "images/007.png", "a b/ü (1).png", "..a/b..", "images/東京.png", "-x", "~", "👨\u200d👩.jpg"]
)
def test_a_path_that_stays_inside_is_returned_as_it_is(text):
    assert relative_path(text, "image") == text


@pytest.mark.parametrize(
    "text",
    ["", ".", "..", "/etc/passwd", "../a", "a/../../b", "a/./b", "a//b", "a/", "a\nb", "a\x1b[2Jb", "a\x00", "a\u202eb",
     "\ud800", "a\x9b", "x" * 256, "é" * 128, "x/" * 600 + "x", None, 5, ["a"], b"a"],
)  # fmt: skip
def test_anything_else_is_refused_in_one_printable_line(text):
    with pytest.raises(ArtifactDamaged) as fault:
        relative_path(text, "image of view 3")
    assert "image of view 3" in str(fault.value)
    assert str(fault.value).isprintable() and len(str(fault.value)) < 300


def test_the_fault_is_the_callers():
    with pytest.raises(BadInput):
        relative_path("..", "mask", BadInput)


def test_a_file_name_has_one_part():
    assert file_name("007.png", "view") == "007.png"
    with pytest.raises(ArtifactDamaged, match="without '/'"):
        file_name("a/b", "view")


def test_what_a_terminal_would_obey_is_escaped():
    assert printable("a\x1b[1mb\r\nc\x9b\u202e\ud800") == r"a\x1b[1mb\r\nc\x9b\u202e\ud800"
    assert printable("Äpfel 東京 – 100 %") == "Äpfel 東京 – 100 %"


@pytest.mark.parametrize(
    "text",
    [
        "C:/a.png",
        "..\\a.png",
        "a/nul",
        "CON.png",
        "Com1.tar.gz",
        "lpt\u00b9",
        "a./b",
        "a /b",
        '"hi".png',
        "what?",
        "a|b",
    ],
)
def test_windows_refuses_names_that_mean_something_else_there(monkeypatch, text):
    monkeypatch.setattr(safe_names, "WINDOWS", True)
    with pytest.raises(ArtifactDamaged, match="which Windows cannot store"):
        safe_names.relative_path(text, "path of a file")
    monkeypatch.setattr(safe_names, "WINDOWS", False)
    assert safe_names.relative_path(text, "path of a file") == text


@pytest.mark.parametrize("text", ["images/001.png", "console.png", "null", "com10", "a.b/c", "auxiliary"])
def test_windows_takes_ordinary_names(monkeypatch, text):
    monkeypatch.setattr(safe_names, "WINDOWS", True)
    assert safe_names.relative_path(text, "path of a file") == text
