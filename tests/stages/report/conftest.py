import pytest

from tests.stages.report import sample_pages


@pytest.fixture(scope="session")
def page_folder(tmp_path_factory):
    """A folder with eval.html, compare.html and stress.html."""
    folder = tmp_path_factory.mktemp("pages")
    pages = {
        "eval": sample_pages.evaluation(),
        "compare": sample_pages.comparison(),
        "stress": sample_pages.stress(folder),
    }
    for name, page in pages.items():
        (folder / f"{name}.html").write_text(page, encoding="utf-8")
    return folder
