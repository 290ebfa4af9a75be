"""Room for images before a bake, and where they go when the output folder fails at its end."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from boxes import bake_folder, lamp_scene, list_files
from leaflight.core.output.image_file import read_image
from leaflight.core.util.job import RESULT_FILE
from leaflight.core.util.messages import Done, Status, Warning_
from leaflight.core.util.settings import Settings

pytestmark = pytest.mark.usefixtures("open_image_io")
QUICK = Settings(size=32, padding=1, workers=1, error=0.3, max_photons=20_000)


@pytest.fixture
def spare_home(tmp_path, monkeypatch):
    """A home folder of the test's own."""
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "home")
    (tmp_path / "home").mkdir()
    return tmp_path / "home"


def test_what_cannot_be_written_at_the_end_is_kept_elsewhere(tmp_path, spare_home):
    """Minutes of work are not thrown away because a disk is full or a stick was pulled out."""
    images = tmp_path / "images"

    def tell(message):
        if message == Status("write", "Writing images"):
            shutil.rmtree(images)
            images.write_text("in the way")

    settings = replace(QUICK, passes=("combined", "albedo"))
    messages, result = bake_folder(tmp_path / "temporary" / "job", lamp_scene(), settings, tell=tell, output=str(images))
    spare = Path(result["spare"])
    assert spare.parent == tmp_path / "temporary"
    assert list_files(spare) == ["room_0.albedo.exr", "room_0.combined.exr"]
    assert {str(Path(file["path"]).parent) for file in result["files"]} == {str(spare)}
    assert read_image(Path(result["files"][0]["path"]))[0].max() > 0.01
    (told,) = [message.text for message in messages if isinstance(message, Warning_) and str(spare) in message.text]
    assert told.startswith(str(tmp_path / "images"))
    assert isinstance(messages[-1], Done)


def test_half_a_bake_is_not_left_behind(tmp_path, spare_home):
    blocked = tmp_path / "job" / "images" / "room_0.emission.exr"
    blocked.mkdir(parents=True)  # a folder where the second image should go
    settings = replace(QUICK, passes=("combined", "emission", "albedo"))
    _, result = bake_folder(tmp_path / "job", lamp_scene(), settings)
    assert list_files(tmp_path / "job" / "images") == [blocked.name]
    assert len(list_files(Path(result["spare"]))) == 3


def test_where_nothing_can_be_written_anywhere_the_first_reason_is_told(tmp_path, spare_home, monkeypatch):
    def fail(path, *_, **__):
        raise OSError(f"{path}: cannot be written (planted)")

    monkeypatch.setattr("leaflight.core.output.image_file.write_image", fail)
    with pytest.raises(OSError, match=r"job/images/room_0\.combined\.exr: cannot be written \(planted\)"):
        bake_folder(tmp_path / "job", lamp_scene(), QUICK)
    assert not (tmp_path / "job" / RESULT_FILE).exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["home", "job"]
    assert list_files(spare_home) == []


@pytest.mark.parametrize(("part", "refused"), [(0.05, True), (0.5, False), (2.0, None)])
def test_too_little_room_is_told_before_the_light_is_computed(tmp_path, monkeypatch, part, refused):
    wanted = 32 * 32 * (8 + 4) * 2
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage._replace(free=int(part * wanted)))
    settings = replace(QUICK, passes=("combined", "albedo"), formats=("exr", "png"))
    if refused:
        with pytest.raises(OSError, match=r"images: has room for 1 kB, and the images may take 25 kB; make room, choose another output"):
            bake_folder(tmp_path, lamp_scene(), settings)
        return
    messages, _ = bake_folder(tmp_path, lamp_scene(), settings)
    told = [number for number, message in enumerate(messages) if isinstance(message, Warning_) and "has room for" in message.text]
    lit = next(number for number, message in enumerate(messages) if isinstance(message, Status) and message.stage == "photons")
    assert len(told) == (refused is False)
    assert all(number < lit for number in told)
