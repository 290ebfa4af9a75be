"""Kept pages: what a path names never changes, and a page goes when no .blend needs it."""

import os

import pytest
from leaflight.addon.show.page_store import STORE, claim_pages, find_folder, is_kept, keep_page, recover_page, release_pages


@pytest.fixture
def image(tmp_path):
    path = tmp_path / "maps" / "room_0.combined.exr"
    path.parent.mkdir()
    path.write_bytes(b"first")
    return path


def write(path, content):
    """As a bake writes: the file takes the other's place when it is whole."""
    unfinished = path.with_suffix(".part")
    unfinished.write_bytes(content)
    os.replace(unfinished, path)


def refuse(*_):
    raise OSError("no links on this disk")


@pytest.mark.parametrize("links", [True, False])
def test_a_kept_page_outlives_the_next_bake(image, monkeypatch, links):
    if not links:
        monkeypatch.setattr(os, "link", refuse)
    first = keep_page(image)
    write(image, b"second")
    second = keep_page(image)
    assert (first.read_bytes(), second.read_bytes(), image.read_bytes()) == (b"first", b"second", b"second")
    assert first.name == second.name == image.name
    assert find_folder(first) == find_folder(image) == image.parent
    assert is_kept(first)
    assert not is_kept(image)
    assert keep_page(image) == second
    assert sorted(path.name for path in first.parent.iterdir()) == [image.name]


def test_a_page_that_was_painted_over_is_made_again(image, monkeypatch):
    monkeypatch.setattr(os, "link", refuse)
    keep_page(image).write_bytes(b"other")
    assert keep_page(image).read_bytes() == b"first"


def test_a_missing_page_is_recovered_from_the_same_content_only(image):
    kept = keep_page(image)
    kept.unlink()
    assert recover_page(kept)
    assert kept.read_bytes() == b"first"
    kept.unlink()
    write(image, b"second")
    assert not recover_page(kept)
    image.unlink()
    assert not recover_page(kept)


def test_pages_go_when_no_blend_that_is_there_needs_them(image, tmp_path):
    blends = [tmp_path / f"{name}.blend" for name in "abc"]
    for blend in blends[:2]:
        blend.touch()
    first = keep_page(image)
    claim_pages([first, image], blends[0])
    claim_pages([first], blends[1])
    claim_pages([first], blends[2])  # of a file that was deleted since
    write(image, b"second")
    second = keep_page(image)
    release_pages(image.parent, blends[0], {second})
    assert first.is_file(), "the second .blend needs it"
    release_pages(image.parent, tmp_path / "stranger.blend", set())
    assert first.is_file()
    release_pages(image.parent, blends[1], {second})
    assert not first.parent.exists()
    assert second.is_file(), "it was never saved: nobody knows yet who needs it"
    claim_pages([second], blends[0])
    release_pages(image.parent, blends[0], set())
    assert not (image.parent / STORE).exists()
    assert image.read_bytes() == b"second"


def test_claims_hold_where_all_is_moved_together(image, tmp_path):
    blend = tmp_path / "room.blend"
    blend.touch()
    kept = keep_page(image)
    claim_pages([kept], blend)
    moved = tmp_path.with_name(f"{tmp_path.name} moved")
    tmp_path.rename(moved)
    release_pages(moved / "maps", moved / "room.blend", set())
    assert not (moved / "maps" / STORE).exists()
