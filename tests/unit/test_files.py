"""Files that are there whole or not at all, wherever links of their names lead."""

import numpy as np
import pytest
from leaflight.core.util.files import save_whole, write_text_whole


def test_what_is_written_takes_the_place_of_the_last(tmp_path):
    for number in range(2):
        save_whole(tmp_path / ".note.npz", {"a": np.arange(number)})
        write_text_whole(tmp_path / "info.json", f"ä{number}")
    with np.load(tmp_path / ".note.npz") as stored:
        assert stored["a"].tolist() == [0]
    assert (tmp_path / "info.json").read_text(encoding="utf-8") == "ä1"
    assert sorted(path.name for path in tmp_path.iterdir()) == [".note.npz", "info.json"]


def test_what_cannot_be_written_leaves_the_last(tmp_path):
    write_text_whole(tmp_path / "info.json", "old")
    with pytest.raises(UnicodeEncodeError):
        write_text_whole(tmp_path / "info.json", "\ud800")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match=r"."):
        write_text_whole(tmp_path / "folder", "new")
    assert (tmp_path / "info.json").read_text(encoding="utf-8") == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "info.json"]


def test_a_link_of_the_name_is_replaced_not_followed(tmp_path):
    victim, link = tmp_path / "victim.txt", tmp_path / "info.json"
    victim.write_text("the user's")
    link.symlink_to(victim)
    write_text_whole(link, "ours")
    assert (victim.read_text(), link.is_symlink(), link.read_text()) == ("the user's", False, "ours")
