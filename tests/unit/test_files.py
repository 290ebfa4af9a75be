"""Files that are there whole or not at all, wherever links of their names lead."""

import errno
import gc
import io
import sys

import numpy as np
import pytest
from leaflight.core.util.files import save_whole, write_arrays, write_text_whole


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


@pytest.mark.parametrize("room", [0, 5000])
def test_a_full_disk_is_one_error(monkeypatch, room):
    """An archive that is left open has Python say later that it could not be closed."""

    class FullDisk(io.BytesIO):
        is_full = False

        def write(self, data):
            self.is_full = self.is_full or self.tell() + len(data) > room
            if self.is_full:
                raise OSError(errno.ENOSPC, "No space left on device")
            return super().write(data)

    said = []
    monkeypatch.setattr(sys, "unraisablehook", said.append)
    with pytest.raises(OSError, match="No space left"):
        write_arrays(FullDisk(), {"a": np.zeros(1000), "b": np.zeros(1000)})
    gc.collect()
    assert said == []
