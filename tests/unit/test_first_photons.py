"""Photons that are traced before there are texels are those that the first round would trace itself."""

import json

import numpy as np
import pytest
from boxes import lamp_scene
from leaflight.core.bake import bake
from leaflight.core.bake.first_photons import FirstPhotons
from leaflight.core.bake.photon_shards import PhotonShard
from leaflight.core.parallel import executors
from leaflight.core.scene.snapshot import save_snapshot
from leaflight.core.util.job import RESULT_FILE, SNAPSHOT_FILE, Job
from leaflight.core.util.settings import Settings

SETTINGS = Settings(size=32, padding=1, error=0.5, max_photons=20_000)


@pytest.fixture
def awake():
    """Two processes, of which one is there from the start."""
    with executors.LocalExecutor(2) as executor:
        executor.wake()
        yield executor


def shard_of(round_, number, photons, **others):
    return PhotonShard(
        tracing="", view="", seed=0, round=round_, shard=number, photons=photons, max_depth=9, degree=1, skip_first=True, **others
    )


def test_what_goes_wrong_there_is_told_where_they_are_taken(tmp_path, awake):
    (tmp_path / SNAPSHOT_FILE).write_bytes(b"no snapshot")
    first = FirstPhotons.send(tmp_path, SETTINGS, awake)
    with pytest.raises(ValueError, match=r"snapshot\.npz"):
        first.take(shard_of(0, 0, 10_000))


@pytest.mark.usefixtures("open_image_io")
def test_a_bake_is_the_same_with_them(tmp_path, monkeypatch):
    """Of processes that wait for their job, and of one that does all by itself."""
    traced, files = [], []
    take = FirstPhotons.take
    monkeypatch.setattr(FirstPhotons, "take", lambda first, shard: traced.append(take(first, shard)) or traced[-1])
    ahead = executors.Ahead()
    ahead.wake()  # pytest has threads, so that they are no copies
    for name, opener in (("ahead", ahead.open), ("alone", executors.open_executor)):
        folder = tmp_path / name
        folder.mkdir()
        save_snapshot(folder / SNAPSHOT_FILE, lamp_scene())
        workers_asked = 0 if name == "ahead" else 1
        Job(Settings(size=32, padding=1, error=0.5, max_photons=20_000, workers=workers_asked), str(folder / "out"), "box").save(folder)
        bake.run_bake(folder, lambda message: None, lambda: False, opener)
        result = json.loads((folder / RESULT_FILE).read_text(encoding="utf-8"))
        files.append((np.fromfile(result["files"][0]["path"], np.uint8).tobytes(), result["photons"]))
    assert any(shard.hits for shard in traced) == (executors.count_processors(0) > 1)
    assert files[0] == files[1]
