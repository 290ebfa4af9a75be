"""Files that are there whole or not at all, and names that differ wherever they must."""

import errno
import gc
import io
import sys

import numpy as np
import pytest
from leaflight.core.util import file_names
from leaflight.core.util.files import save_whole, write_arrays, write_text_whole


# Files that are there whole or not at all, wherever links of their names lead.
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


# Names of files: the pattern, and names that differ wherever they must.
def fill(pattern):
    return file_names.fill_pattern(pattern, "Floor", "combined", 3)


@pytest.mark.parametrize(
    ("pattern", "name"),
    [("{name}.{pass}", "Floor.combined"), ("{pass}-{name}", "combined-Floor"), ("lm_{page}", "lm_3"), ("{page}{page} ä", "33 ä")],
)
def test_fields_are_filled_in(pattern, name):
    assert file_names.find_pattern_error(pattern) == ""
    assert fill(pattern) == name


def test_what_looks_like_a_field_in_a_name_stays():
    assert file_names.fill_pattern("{name}.{pass}", "{pass}", "albedo", 0) == "{pass}.albedo"


@pytest.mark.parametrize(
    ("pattern", "error"),
    [
        ("", "so that each page has a file of its own"),
        ("{pass}", "so that each page has a file of its own"),
        ("{name}{name}", "expected {name} once"),
        ("{name}.{size}", r"no other fields than {name}, {pass}, {page}, got '{name}.{size}'"),
        ("{name", "no other fields"),
        ("{name}}", "no other fields"),
        ("{{name}}", "no other fields"),
        ("maps/{name}", "a folder is given by the output"),
        ("..\\{name}", "a folder is given by the output"),
        ("{name}" + "x" * 31, "at most 30 letters"),
    ],
)
def test_what_is_wrong_with_a_pattern_is_told(pattern, error):
    assert error in file_names.find_pattern_error(pattern)


def test_longest_names_fit_a_disk():
    """255 bytes, with the ending, and what is put around a name while the file is written."""
    name = file_names.clean_name("ä" * 300)
    longest = file_names.fill_pattern("{name}{pass}{page}" + "x" * file_names.MAX_PATTERN_BYTES, name, "leaf_edges", 99999)
    assert len(f".{longest}.logluv.png.4194304.part".encode()) <= 255


@pytest.mark.parametrize(
    ("name", "clean"),
    [
        ("a/b", "a_b"),
        ("..", "_"),
        (" Ä 1. ", "Ä 1"),
        ("con\n", "con_"),
        ("", "_"),
        ("con", "_con"),
        ("Nul.1", "_Nul.1"),
        ("console", "console"),
    ],
)
def test_names_are_made_such_that_files_can_have_them(name, clean):
    assert file_names.clean_name(name) == clean


def test_equal_names_get_underscores():
    assert file_names.make_unique(["a", "A", "b", "a"]) == ["a", "A_", "b", "a__"]


def test_names_of_many_objects_take_no_time():
    """Fifty thousand, which would take minutes if each were compared with each."""
    names = [f"Cube.{number:05d}.{name}" for number in range(10_000) for name in ("combined", "direct", "indirect", "albedo", "stderr")]
    assert file_names.make_unique(names) == names


def test_only_patterns_with_a_pass_tell_passes_apart():
    assert file_names.has_pass("{name}.{pass}")
    assert not file_names.has_pass("{name}.pass")


def test_names_that_look_alike_are_two_files():
    """One letter with an accent, or a letter and an accent behind it: some disks take them for the same name."""
    import unicodedata

    whole, parts = (unicodedata.normalize(form, "Café") for form in ("NFC", "NFD"))
    assert whole != parts
    assert file_names.make_unique([whole, parts]) == [whole, f"{parts}_"]
