"""The zip that users install: its manifest, what is in it, its wheels; and what a machine lacks for pip's bpy."""

import shutil
import sys
import tomllib
import zipfile
from pathlib import Path

import build_zip
import check_system
import pytest

ROOT = Path(__file__).resolve().parent.parent

BLENDER_PYTHONS = {"cp311", "cp313"}

LDD_OF_A_BARE_MACHINE = """\
	linux-vdso.so.1 (0x00007f77aa34b000)
	libX11.so.6 => /lib/x86_64-linux-gnu/libX11.so.6 (0x00007f779e6be000)
	libXi.so.6 => not found
	libSM.so.6 => not found
	libSM.so.6 => not found
	libunheard.so.3 => not found
"""
LDD_OF_AN_OLD_MACHINE = """\
/venv/bpy/__init__.so: /lib/x86_64-linux-gnu/libm.so.6: version `GLIBC_2.38' not found (required by /venv/bpy/__init__.so)
	libX11.so.6 => /lib/x86_64-linux-gnu/libX11.so.6 (0x00007f779e6be000)
"""


@pytest.fixture(scope="module")
def manifest():
    return build_zip.read_manifest(ROOT)


def test_missing_libraries_are_named_with_their_packages():
    assert check_system.describe_missing(LDD_OF_A_BARE_MACHINE) == [
        "bpy needs libXi.so.6, which this machine lacks: apt-get install libxi6",
        "bpy needs libSM.so.6, which this machine lacks: apt-get install libsm6",
        "bpy needs libunheard.so.3, which this machine lacks: install the package that has it (apt-file search libunheard.so.3)",
    ]
    assert check_system.list_packages(LDD_OF_A_BARE_MACHINE) == ["libxi6", "libsm6"]


def test_old_system_is_named():
    assert check_system.describe_missing(LDD_OF_AN_OLD_MACHINE) == [
        "bpy needs GLIBC_2.38, and this machine's library is older: use a newer system"
    ]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux wheels of bpy lean on the system")
def test_check_fails_where_ldd_misses_a_library(monkeypatch, capsys):
    monkeypatch.setattr(check_system, "run_ldd", lambda library: LDD_OF_A_BARE_MACHINE)
    assert check_system.main([]) == 1
    assert "All at once: apt-get install libxi6 libsm6" in capsys.readouterr().err
    monkeypatch.setattr(check_system, "run_ldd", lambda library: "	libm.so.6 => /lib/libm.so.6 (0x00007f779e6be000)\n")
    assert check_system.main([]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux wheels of bpy lean on the system")
def test_ldd_reads_the_installed_bpy():
    assert "libembree4" in check_system.run_ldd(check_system.find_bpy_folder() / "__init__.so")


def test_manifest_and_pip_package_agree(manifest):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (manifest["id"], manifest["version"]) == (project["name"], project["version"])


def test_manifest_keeps_the_extension_site_rules(manifest):
    for text in (manifest["tagline"], *manifest["permissions"].values()):
        assert len(text) <= 64
        assert text[-1].isalnum()
    assert "blender" not in manifest["name"].lower()


def test_every_platform_has_both_wheels_for_every_python(manifest):
    found = set()
    for path in manifest["wheels"]:
        name, _, python, _, platforms = Path(path).stem.split("-")
        system = {"manylinux": "linux-x64", "win": "windows-x64", "macosx": "macos-arm64"}[platforms.split("_")[0]]
        found.add((name, python, system))
    expected = {(name, python, system) for name in ("embreex", "xatlas") for python in BLENDER_PYTHONS for system in manifest["platforms"]}
    assert found == expected
    assert len(manifest["wheels"]) == len(expected)


def test_wheel_name_tells_pip_what_to_fetch():
    arguments = build_zip.pip_arguments_of_wheel("xatlas-0.0.11-cp313-cp313-manylinux_2_17_x86_64.manylinux2014_x86_64.whl")
    platforms = "--platform manylinux_2_17_x86_64 --platform manylinux2014_x86_64"
    assert " ".join(arguments) == f"xatlas==0.0.11 --python-version 3.13 --implementation cp --abi cp313 {platforms}"
    with pytest.raises(ValueError, match=r"xatlas-0\.0\.11\.tar\.gz: expected"):
        build_zip.pip_arguments_of_wheel("xatlas-0.0.11.tar.gz")


def test_local_manifest_lists_only_the_folder_s_wheels():
    text = build_zip.replace_wheels((ROOT / build_zip.MANIFEST).read_text(encoding="utf-8"), ["a-1-cp314-cp314-linux_x86_64.whl"])
    changed = tomllib.loads(text)
    assert changed["wheels"] == ["./wheels/a-1-cp314-cp314-linux_x86_64.whl"]
    assert "platforms" not in changed
    with pytest.raises(ValueError, match="expected one list of wheels, got 0"):
        build_zip.replace_wheels('id = "leaflight"\n', [])


def test_stray_file_in_a_zip_is_refused(tmp_path):
    zip_path = tmp_path / "leaflight.zip"
    with zipfile.ZipFile(zip_path, "w") as archive:
        archive.writestr("core/scene/scene.py", "")
        archive.writestr("notes.txt", "")
    with pytest.raises(ValueError, match=r"leaflight\.zip: notes\.txt would be shipped"):
        build_zip.check_contents(zip_path)


@pytest.mark.parametrize("stray", ["w314/embreex-4-cp314-cp314-linux_x86_64.whl", ""])
def test_no_zip_is_left_where_one_holds_a_stray_file(tmp_path, monkeypatch, stray):
    """Blender's builder packs a folder of wheels that lies in the checkout; validation itself is not run here."""

    def build(command, *arguments):
        names = ["__init__.py", *filter(None, [stray])]
        for platform in ("linux_x64", "windows_x64") if command == "build" else ():
            with zipfile.ZipFile(tmp_path / f"leaflight-1.0.0-{platform}.zip", "w") as archive:
                for name in names if platform == "windows_x64" else names[:1]:
                    archive.writestr(name, "")

    monkeypatch.setattr(build_zip, "run_blender_ext", build)
    (tmp_path / "leaflight-0.9.0.zip").touch()  # of an earlier build
    (tmp_path / "notes.zip").touch()
    if not stray:
        build_zip.build_zips(tmp_path, tmp_path, None)
        assert len(list(tmp_path.glob("leaflight-1.0.0-*.zip"))) == 2
        return
    with pytest.raises(ValueError, match=r"w314/embreex.* would be shipped"):
        build_zip.build_zips(tmp_path, tmp_path, None)
    assert [path.name for path in tmp_path.glob("*.zip")] == ["notes.zip"]


def test_blender_builds_the_extension_and_only_that(tmp_path):
    """Blender's builder on a copy with every kind of thing a working folder has, and one wheel that needs no download."""
    source = tmp_path / "source"
    heavy = shutil.ignore_patterns(".git", ".venv*", ".*_cache", ".hypothesis", "wheels", "out", "dist", "sample_blends")
    shutil.copytree(ROOT, source, ignore=heavy)
    wheel = "example-1-py3-none-any.whl"
    for litter in (
        f"wheels/{wheel}",
        "out/a.exr",
        "sample_blends/a.blend",
        "docs/a.md",
        ".venv-3.11/a.py",
        "core/__pycache__/a.pyc",
        "a.blend1",
    ):
        (source / litter).parent.mkdir(parents=True, exist_ok=True)
        (source / litter).write_bytes(b"")
    manifest = source / build_zip.MANIFEST
    manifest.write_text(build_zip.replace_wheels(manifest.read_text(encoding="utf-8"), [wheel]), encoding="utf-8")
    zip_path = tmp_path / "leaflight.zip"
    build_zip.run_blender_ext("build", "--source-dir", str(source), "--output-filepath", str(zip_path))
    build_zip.finish_zip(zip_path)
    with zipfile.ZipFile(zip_path) as archive:
        names = set(archive.namelist())
    assert {"__init__.py", "core/util/settings.py", "addon/__init__.py", "LICENSE", f"wheels/{wheel}"} <= names
    assert not [name for name in names if "__pycache__" in name or name.endswith(".blend1")]
