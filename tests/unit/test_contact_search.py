"""Contacts that several processes look for are those that one finds."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import prepare_folder, to_bytes
from leaflight.core.bake import bake
from leaflight.core.output.image_file import read_image
from leaflight.core.parallel import executors, folders
from leaflight.core.scene.scene import Light
from leaflight.core.scene.snapshot import save_snapshot
from leaflight.core.transport import traced_scene
from leaflight.core.transport.contact_map import cut_at_contacts, find_contacts
from leaflight.core.transport.contact_search import search_contacts, split_at_charts
from leaflight.core.util.job import SNAPSHOT_FILE, Job
from leaflight.core.util.settings import Settings
from processes import wait_until_ready
from scenes import box_mesh, make_scene, quad_mesh
from words_heard import check_every_word_is_heard

SETTINGS = Settings(size=224, direct="photons", max_photons=20_000, error=0.5, passes=("lighting",))
LAMP = Light("POINT", "Lamp", (0.2, 0.5, 0.9), power_rgb=(1.0,) * 3)


@pytest.fixture
def scene():
    """Boxes on a floor that a wall parts."""
    boxes = [box_mesh(f"Box {k}", (0.2, 0.2, 0.3), (x, y, 0.15)) for k, (x, y) in enumerate([(0.2, 0.2), (0.4, 0.2), (0.7, 0.7)])]
    wall = replace(box_mesh("Wall", (0.02, 0.7, 0.5), (0.55, 0.3, 0.25)), receives=False)
    return make_scene([quad_mesh("Floor"), *boxes, wall], [LAMP])


@pytest.fixture
def prepared(tmp_path, scene):
    """It in a folder: the opened scene, the atlas and the texels, enough of them for two processes."""
    atlas, texels = prepare_folder(tmp_path, scene, SETTINGS)
    yield traced_scene.open_scene(str(tmp_path)), atlas, texels
    folders.forget_folders()


@pytest.fixture
def as_many(monkeypatch):
    """Has so many processes counted, of which this one does all the work."""
    return lambda count: monkeypatch.setattr(executors, "count_idle", lambda executor: count)


@pytest.mark.parametrize("count", [2, 3])
def test_parts_are_found_and_joined_to_the_same_bytes(tmp_path, prepared, as_many, count):
    opened, _, texels = prepared
    as_many(count)
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


def test_whoever_wants_no_contacts_any_more_is_heard_between_parts(tmp_path, prepared, as_many):
    opened, _, texels = prepared
    as_many(3)
    check_every_word_is_heard(lambda watch: search_contacts(tmp_path, opened, texels, executors.InlineExecutor(), 1, watch))


def test_a_bake_by_two_processes_has_the_light_of_one(tmp_path, scene, as_many, open_image_io):
    """Though they are still at the first photons, so that a bake as small as this would not ask them."""
    images = []
    for count in (1, 2):
        folder = tmp_path / str(count)
        folder.mkdir()
        save_snapshot(folder / SNAPSHOT_FILE, scene)
        Job(replace(SETTINGS, workers=count), str(folder / "images"), "room").save(folder)
        executor = executors.make_executor(count)
        if count > 1:
            wait_until_ready(executor)
            as_many(count)
        bake.run_bake(folder, lambda message: None, lambda: False, lambda settings, executor=executor: executor)
        images.append(read_image(folder / "images" / "room_0.lighting.exr")[0])
    np.testing.assert_array_equal(*images)
