"""Compiled kernels are found again only while every source file that they are made of is the same."""

import shutil
from pathlib import Path

import stylerf.kernels as package


def test_cache_folder_moves_when_any_kernel_source_changes(monkeypatch, tmp_path):
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setenv("STYLERF_CACHE", str(tmp_path))
    before = package.kernel_cache_dir()
    assert before.is_relative_to(tmp_path / "kernels")
    copy = tmp_path / "copy"
    shutil.copytree(Path(package.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(package, "__file__", str(copy / "__init__.py"))
    assert package.kernel_cache_dir() == before
    with (copy / "cpu" / "march.py").open("a") as source:
        source.write("# a helper that other files inline has changed\n")
    assert package.kernel_cache_dir() != before


def test_a_folder_that_the_user_names_is_taken_as_it_is(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert package.kernel_cache_dir() == tmp_path
