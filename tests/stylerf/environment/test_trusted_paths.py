"""What somebody else could have written is reported from what is ours."""

import os
import stat

import pytest

from stylerf.environment import trusted_paths
from stylerf.environment.trusted_paths import not_ours


@pytest.fixture
def kept(tmp_path):
    """A private folder with a file two levels down."""
    folder = tmp_path / "root" / "kept"
    (folder / "sub").mkdir(parents=True)
    (folder / "sub" / "file").touch()
    for place in (tmp_path / "root", folder, folder / "sub"):
        place.chmod(0o755)
    (folder / "sub" / "file").chmod(0o644)
    return folder


def test_a_folder_of_ours_is_ours(kept):
    assert not_ours(kept) is None
    kept.chmod(0o700)
    assert not_ours(kept) is None and not_ours(kept / "sub" / "file") is None


def test_sticky_folders_may_lead_to_it(kept):
    kept.parent.chmod(0o1777)
    assert not_ours(kept) is None


@pytest.mark.parametrize("place", [".", "sub", "sub/file"])
def test_a_part_that_others_may_write_to(kept, place):
    (kept / place).chmod(0o777)
    why = not_ours(kept)
    assert "can be written by others" in why and (place == "." or f"holds {place}" in why)


def test_what_others_cannot_reach_they_cannot_write(kept):
    (kept / "sub").chmod(0o775)
    (kept / "sub" / "file").chmod(0o666)
    kept.chmod(0o700)
    assert not_ours(kept) is None


def test_a_folder_on_the_way_that_others_may_write_to(kept):
    kept.parent.chmod(0o777)
    assert not_ours(kept) == f"is in {kept.parent}, which can be written by others"


def test_a_group_may_not_write_unless_it_is_the_users_own(kept, monkeypatch):
    kept.chmod(0o770)
    own = kept.stat().st_uid == kept.stat().st_gid
    monkeypatch.setattr(trusted_paths.os, "getegid", lambda: kept.stat().st_gid)
    assert (not_ours(kept) is None) == own
    monkeypatch.setattr(trusted_paths.os, "getegid", lambda: kept.stat().st_gid + 1)
    assert not_ours(kept) == "can be written by others"


def test_links_are_refused_but_on_the_way(kept, tmp_path):
    (tmp_path / "way").symlink_to(kept.parent)
    assert not_ours(tmp_path / "way" / "kept") is None
    (tmp_path / "link").symlink_to(kept)
    assert not_ours(tmp_path / "link") == "is a link"
    (kept / "sub" / "link").symlink_to(kept / "sub" / "file")
    assert not_ours(kept) == "holds sub/link, which is a link"


def test_a_way_through_a_link_into_a_folder_that_others_may_write_to(kept, tmp_path):
    (tmp_path / "way").symlink_to(kept.parent)
    kept.parent.chmod(0o777)
    assert "can be written by others" in not_ours(tmp_path / "way" / "kept")


def test_what_belongs_to_somebody_else(kept, monkeypatch):
    owner = os.geteuid()
    monkeypatch.setattr(trusted_paths.os, "geteuid", lambda: owner + 1)
    assert not_ours(kept) == f"belongs to user {owner}"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
@pytest.mark.parametrize("place", [".", "sub", "sub/file", ".."])
def test_a_part_that_was_given_away(kept, place):
    os.chown(kept / place, 4711, -1)
    assert "belongs to user 4711" in not_ours(kept)
    assert stat.S_IMODE(kept.stat().st_mode) == 0o755
