"""Contacts that several processes look for are those that one finds."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import prepare_folder, to_bytes
from leaflight.core.parallel import executors, folders
from leaflight.core.scene.scene import Light
from leaflight.core.transport import contact_search, traced_scene
from leaflight.core.transport.contact_map import LOOKING, cut_at_contacts, find_contacts
from leaflight.core.transport.contact_search import search_contacts, split_at_charts
from leaflight.core.util.progress import Interrupted
from leaflight.core.util.settings import Settings
from processes import wait_until_ready
from scenes import box_mesh, make_scene, quad_mesh
from words_heard import check_every_word_is_heard

LAMP = Light("POINT", "Lamp", (0.2, 0.5, 0.9), power_rgb=(1.0,) * 3)
PAGE = 1 << 20
EVEN = np.arange(101) * 10_000


@pytest.fixture
def prepared(tmp_path, monkeypatch):
    """Boxes on a floor that a wall parts, in a folder: the opened scene, the atlas and the texels. Few of these are worth a part."""
    monkeypatch.setattr(contact_search, "_LEAST", 100)
    boxes = [box_mesh(f"Box {k}", (0.2, 0.2, 0.3), (x, y, 0.15)) for k, (x, y) in enumerate([(0.2, 0.2), (0.4, 0.2), (0.7, 0.7)])]
    wall = replace(box_mesh("Wall", (0.02, 0.7, 0.5), (0.55, 0.3, 0.25)), receives=False)
    scene = make_scene([quad_mesh("Floor"), *boxes, wall], [LAMP])
    atlas, texels = prepare_folder(tmp_path, scene, Settings(size=64))
    yield traced_scene.open_scene(str(tmp_path)), atlas, texels
    folders.forget_folders()


@pytest.fixture
def as_many(monkeypatch):
    """Has so many processes counted, of which this one does all the work."""
    return lambda count: monkeypatch.setattr(executors, "count_idle", lambda executor: count)


@pytest.mark.parametrize("count", [2, 3, 7])
def test_parts_are_found_and_joined_to_the_same_bytes(tmp_path, prepared, as_many, part_entries, count):
    opened, _, texels = prepared
    as_many(count)
    part_entries(300)
    assert len(split_at_charts(texels.chart_start, count)) > 1
    whole = find_contacts(opened, texels)
    assert to_bytes(search_contacts(tmp_path, opened, texels, executors.InlineExecutor(), 1)) == to_bytes(whole)
    assert len(np.unique(texels.texel_chart[whole.touched])) > 3
    assert len(whole.borders.entry)


def test_another_process_finds_the_same_and_the_map_can_be_cut_at_it(tmp_path, prepared):
    """Wherever the texels are opened from then on they are those that were cut."""
    opened, atlas, texels = prepared
    whole = to_bytes(find_contacts(opened, texels))
    with executors.LocalExecutor(2) as executor:
        wait_until_ready(executor)
        found = search_contacts(tmp_path, opened, texels, executor, 2)
        assert to_bytes(found) == whole
        assert (tmp_path / folders.TEXELS_FOLDER).exists()
        assert traced_scene.open_tracing.cache_info().currsize == 0
        of_other = executor._pool.submit(
            eval, "__import__('sys').modules['leaflight.core.transport.traced_scene'].open_tracing.cache_info().currsize"
        )
        assert of_other.result() == 0
    assert len(cut_at_contacts(texels, atlas, found)[0].chart_page) > len(texels.chart_page)


@pytest.mark.parametrize(("count", "least"), [(1, 100), (2, 100), (2, PAGE)])
def test_nothing_is_laid_out_where_nobody_shares_the_work(tmp_path, prepared, monkeypatch, count, least):
    """One process, or another that has not started, or too few texels for two."""
    opened, _, texels = prepared
    monkeypatch.setattr(contact_search, "_LEAST", least)
    monkeypatch.setattr(contact_search.shared_arrays, "save_struct", None)
    with executors.make_executor(count) as executor:
        if least == PAGE:
            wait_until_ready(executor)
        assert search_contacts(tmp_path, opened, texels, executor, 2).touched.any()


def test_how_far_all_parts_are_is_told(tmp_path, prepared, as_many):
    opened, _, texels = prepared
    as_many(4)
    told = []
    search_contacts(tmp_path, opened, texels, executors.InlineExecutor(), 1, lambda *word: told.append(word))
    assert {(said, about) for said, _, about in told} == {(LOOKING, "")}
    share = [share for _, share, _ in told]
    assert share == sorted(share)
    assert share[-1] == pytest.approx(0.7)


def test_whoever_wants_no_contacts_any_more_is_heard_between_parts(tmp_path, prepared, as_many):
    opened, _, texels = prepared
    as_many(3)
    check_every_word_is_heard(lambda watch: search_contacts(tmp_path, opened, texels, executors.InlineExecutor(), 1, watch))


def test_a_stop_leaves_no_part_to_be_looked_at(tmp_path, prepared, monkeypatch):
    opened, _, texels = prepared
    monkeypatch.setattr(contact_search, "_MOST", len(texels) // 10)

    def stop(*word):
        raise Interrupted

    executor = executors.LocalExecutor(2)
    wait_until_ready(executor)
    with pytest.raises(Interrupted):
        search_contacts(tmp_path, opened, texels, executor, 2, stop)
    left = list(executor._waiting)
    executor.shutdown(cancel_futures=True)
    assert all(call.cancelled() for call in left)
    assert executor._given == 0


def list_sizes(chart_start, processes):
    """Of the parts, which follow each other and are of whole charts."""
    parts = split_at_charts(np.asarray(chart_start), processes)
    ends = [0, *(part.stop for part in parts)]
    assert [part.start for part in parts] == ends[:-1]
    assert ends[-1] == chart_start[-1]
    assert set(ends) <= set(np.asarray(chart_start).tolist())
    return np.diff(ends).tolist()


def test_parts_are_as_large_for_each_process():
    assert list_sizes(EVEN, 2) == [500_000] * 2
    assert list_sizes(EVEN, 3) == [330_000, 340_000, 330_000]
    assert len(list_sizes(EVEN // 10, 64)) == 6  # fewer entries are not worth another process
    assert list_sizes([0, 0, 400_000, 400_000, 1_000_000, 1_000_000], 2) == [400_000, 600_000]


def test_parts_of_a_large_page_are_as_many_for_each_process():
    """A stop is heard between them."""
    sizes = list_sizes(EVEN * 5, 2)
    assert len(sizes) == 6
    assert max(sizes) <= PAGE


@pytest.mark.parametrize(
    ("chart_start", "processes"),
    [(EVEN, 1), ([0], 2), ([0, 0], 2), ([0, PAGE], 2), (EVEN // 40, 2), ([0, 100_000, 900_000, 1_000_000], 4), (EVEN * 50, 1)],
)
def test_what_is_not_worth_sharing_stays_whole(chart_start, processes):
    """For one process, of few texels, and where one chart has nearly all."""
    assert len(split_at_charts(np.asarray(chart_start), processes)) == 1
