"""Shards on a cluster: a scheduler and workers as processes on loopback give the bytes that one process gives."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("distributed")

from boxes import lamp_scene, prepare_folder, solve_scene
from leaflight.core.bake.solve import LightField
from leaflight.core.integrate import texel_shards
from leaflight.core.parallel import cluster, executors, folders, shared_arrays
from leaflight.core.util.settings import Settings

PATIENCE_S = 60.0
DEADLY_SHARD = 3  # so many are sent, some of them under way, when workers die
SETTINGS = Settings(size=32, padding=1, error=0.01, max_photons=300_000)  # two rounds


@dataclass
class Farm:
    """Processes of a cluster on this machine; worker processes keep their copies below `folder`."""

    folder: Path
    address: str = ""
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start(self, kind: str, *words: str) -> subprocess.Popen[bytes]:
        log = open(self.folder / f"{kind}_{len(self.processes)}.log", "wb")  # noqa: SIM115  its process writes on
        argv = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *words, "--no-dashboard"]
        self.processes.append(subprocess.Popen(argv, stdout=log, stderr=log))
        return self.processes[-1]

    def start_scheduler(self) -> None:
        place = self.folder / "scheduler.json"
        self.start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(place))
        end = time.monotonic() + PATIENCE_S
        while not place.exists() or not place.read_text():
            assert time.monotonic() < end, "no scheduler"
            time.sleep(0.05)
        self.address = json.loads(place.read_text())["address"]

    def start_worker(self) -> subprocess.Popen[bytes]:
        return self.start("worker", self.address, "--no-nanny", "--nthreads", "1", "--local-directory", str(self.folder))

    def wait_for(self, count: int) -> None:
        with cluster.Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=PATIENCE_S)

    def stop(self) -> None:
        for process in reversed(self.processes):
            process.kill()
            process.wait()

    def list_copies(self) -> list[Path]:
        return [path for path in self.folder.glob("dask-scratch-space/*/leaflight/*") if path.is_dir()]


@pytest.fixture(scope="module")
def farm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Farm]:
    """A scheduler and two workers."""
    farm = Farm(tmp_path_factory.mktemp("farm"))
    farm.start_scheduler()
    farm.start_worker()
    farm.start_worker()
    farm.wait_for(2)
    yield farm
    farm.stop()


def to_bytes(light: LightField) -> bytes:
    arrays = (light.solution.flux, light.solution.variance, light.leaves, light.direct.irradiance)
    return b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return to_bytes(solve_scene(tmp_path_factory.mktemp("local"), lamp_scene(), SETTINGS))


def test_same_bytes_as_locally_and_the_folder_is_shared_where_it_is_seen(farm, local, tmp_path):
    with executors.open_executor(replace(SETTINGS, cluster=farm.address)) as executor:
        assert to_bytes(solve_scene(tmp_path, lamp_scene(), SETTINGS, executor)) == local
    assert farm.list_copies() == []


@pytest.fixture
def hidden(monkeypatch):
    """Folders that only this machine can read: without a stamp workers do not take them."""
    stamp = cluster.stamp_folder

    def stamp_and_hide(folder, parts):
        content = stamp(folder, parts)
        (folder / cluster.STAMP_FILE).unlink()
        return content

    monkeypatch.setattr(cluster, "stamp_folder", stamp_and_hide)


def test_a_file_too_long_for_one_message_comes_in_pieces(tmp_path):
    sent = tmp_path / "sent"
    sent.mkdir()
    with open(sent / "data", "wb") as file:
        file.truncate((1 << 26) + 5)
    worker = SimpleNamespace(local_directory=str(tmp_path / "worker"))
    copy = cluster.FolderCopy(str(tmp_path / "elsewhere"), cluster.stamp_folder(sent, ()))
    messages = list(cluster.read_pieces(sent, ()))
    assert len(messages) == 2
    for message in messages:
        cluster.write_pieces(copy, message, worker)
    cluster.finish_copy(copy, worker)
    assert cluster.has_copy(copy, worker)


@pytest.mark.usefixtures("hidden")
def test_folders_that_workers_do_not_see_are_sent(farm, local, tmp_path):
    for name in ("a", "b"):
        with cluster.connect(farm.address) as executor:
            assert to_bytes(solve_scene(tmp_path / name, lamp_scene(), SETTINGS, executor)) == local
    assert len(farm.list_copies()) >= 4  # scene and views, on each of two workers


@pytest.mark.usefixtures("hidden")
def test_killed_workers_cost_time_and_not_the_bake(farm, local, tmp_path, monkeypatch):
    """Nor do workers that come late, to whom nothing has been sent yet."""
    doomed = [process for process in farm.processes[1:] if process.poll() is None]
    shards = []
    with cluster.connect(farm.address) as executor:
        submit = executor.submit

        def submit_and_kill(fn, shard):
            future = submit(fn, shard)
            shards.append(shard)
            if len(shards) == DEADLY_SHARD:
                for process in doomed:
                    process.kill()
                farm.start_worker()
            return future

        monkeypatch.setattr(executor, "submit", submit_and_kill)
        assert to_bytes(solve_scene(tmp_path, lamp_scene(), SETTINGS, executor)) == local
    assert len(shards) > DEADLY_SHARD
    assert [process.wait(PATIENCE_S) for process in doomed] == [-signal.SIGKILL] * len(doomed)


def test_a_folder_that_is_used_again_is_read_again(farm, tmp_path):
    """Workers outlive bakes, and what they keep open must not."""
    means = []
    for power in (10.0, 1.0):
        bright = lamp_scene()
        scene = replace(bright, lights=(replace(bright.lights[0], power_rgb=(power,) * 3),))
        with cluster.connect(farm.address) as executor:
            means.append(solve_scene(tmp_path, scene, replace(SETTINGS, error=0.03, max_photons=100_000), executor).solution.flux.sum())
        shared_arrays.remove_struct(tmp_path / folders.TEXELS_FOLDER)
    folders.forget_folders()
    assert means[0] == pytest.approx(10 * means[1], rel=0.01)


def test_a_later_bake_of_the_same_scene_is_told_anew_where_photons_part(farm, tmp_path):
    """Its second round's view has the name of the first bake's last, and the third round is told what came of the second."""
    for seed, most, rounds in ((1, 300_000, 2), (2, 600_000, 3)):
        settings = replace(SETTINGS, error=0.006, max_photons=most, seed=seed)
        with cluster.connect(farm.address) as executor:
            light = solve_scene(tmp_path, lamp_scene(), settings, executor)
        assert light.rounds == rounds
        shared_arrays.remove_struct(tmp_path / folders.TEXELS_FOLDER)
        folders.forget_folders()
    assert to_bytes(light) == to_bytes(solve_scene(tmp_path / "alone", lamp_scene(), settings))


def test_a_sentence_of_a_shard_comes_through(farm, tmp_path):
    prepare_folder(tmp_path, replace(lamp_scene(), lights=()), SETTINGS)
    shard = texel_shards.DirectShard(str(tmp_path), seed=1, turn=0, start=0, texels=np.arange(9), tolerance=0.1)
    with cluster.connect(farm.address) as executor, pytest.raises(ValueError, match="the scene has no light: add"):
        executor.submit(texel_shards.light_texels, shard).result()


@pytest.mark.parametrize(
    ("address", "why"),
    [("127.0.0.1:1", "Timed out"), ("nonsense", "missing port"), ("a:b", "invalid literal"), ("foo://x:1", "unknown address scheme")],
)
def test_an_address_that_cannot_be_reached_is_a_sentence(monkeypatch, address, why):
    monkeypatch.setattr(cluster, "CONNECT_S", 0.5)
    with pytest.raises(OSError, match=rf"^--cluster {address}: no dask scheduler answers there \({why}.*host:port\.$"):
        cluster.connect(address)


def test_a_worker_with_another_leaflight_is_told(farm, monkeypatch):
    monkeypatch.setattr(cluster, "hash_code", lambda: "newer")
    with pytest.raises(ValueError, match=r"^--cluster: the worker tcp://127\.0\.0\.1:\d+ cannot work for this bake: .*; install the same"):
        cluster.connect(farm.address)


@pytest.mark.slow  # it starts a cluster of its own
def test_a_cluster_that_loses_its_workers_or_its_scheduler_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_S", 1.0)
    monkeypatch.setattr(cluster, "ASK_AGAIN_S", 0.2)
    monkeypatch.setattr(cluster, "NO_WORKER_S", 0.4)
    short = Farm(tmp_path)
    try:
        short.start_scheduler()
        with pytest.raises(OSError, match=r"^--cluster tcp://.*: it has no workers; start some with `dask worker tcp://.*`\.$"):
            cluster.connect(short.address)
        worker = short.start_worker()
        short.wait_for(1)
        with cluster.connect(short.address) as executor:
            waiting = executor.submit(time.sleep, 600)
            worker.kill()
            with pytest.raises(OSError, match=r"all of its workers are gone; start some, and bake again\.$"):
                waiting.result(PATIENCE_S)
            monkeypatch.setattr(cluster, "NO_WORKER_S", PATIENCE_S)
            waiting = executor.submit(time.sleep, 600)
            short.processes[0].kill()
            with pytest.raises(OSError, match=r"its scheduler is gone; start it, and bake again\.$"):
                waiting.result(PATIENCE_S)
    finally:
        short.stop()
