from schemas.journal import Journal


def test_files_count_while_they_are_what_they_were(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).write_text(name)
    journal = Journal(tmp_path / "log" / "frames.jsonl", tmp_path)
    assert not journal.holds(["a"])
    journal.add(["a"])
    journal.add(["b"])
    again = Journal(tmp_path / "log" / "frames.jsonl", tmp_path)
    assert again.holds(["a", "b"]) and not again.holds(["a", "c"])
    (tmp_path / "a").write_text("A")
    assert again.holds(["b"]) and not again.holds(["a"])
    (tmp_path / "b").unlink()
    assert not again.holds(["b"])


def test_a_line_cut_short_and_nonsense_are_passed_over(tmp_path):
    (tmp_path / "a").write_text("a")
    path = tmp_path / "frames.jsonl"
    journal = Journal(path, tmp_path)
    journal.add(["a"])
    path.write_bytes(path.read_bytes() + b'5\n[1]\n\xff\n["b", "12')
    again = Journal(path, tmp_path)
    assert again.holds(["a"])
    (tmp_path / "b").write_text("b")
    again.add(["b"])
    assert Journal(path, tmp_path).holds(["a", "b"])


def test_of_two_lines_for_one_file_the_later_counts(tmp_path):
    journal = Journal(tmp_path / "frames.jsonl", tmp_path)
    for text in ("old", "new"):
        (tmp_path / "a").write_text(text)
        journal.add(["a"])
    assert Journal(tmp_path / "frames.jsonl", tmp_path).holds(["a"])
