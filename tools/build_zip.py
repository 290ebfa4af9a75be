"""Builds the extension's zips with Blender's own builder, found in pip's bpy, and validates each.

python tools/build_zip.py --output dist                        one zip per platform of the manifest
python tools/build_zip.py --output dist --wheels-dir FOLDER    also one zip with the wheels of FOLDER (for a Python that PyPI has none for)
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path
from typing import Any

from check_system import find_bpy_folder

MANIFEST = "blender_manifest.toml"
# Nothing else may be at the top of a zip: a stray file in the working folder must not reach users.
ALLOWED_TOP = {"__init__.py", "__main__.py", MANIFEST, "LICENSE", "README.md", "core", "addon", "wheels"}


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of an extension's folder."""
    return tomllib.loads((folder / MANIFEST).read_text(encoding="utf-8"))


def pip_arguments_of_wheel(file_name: str) -> list[str]:
    """What makes `pip download` fetch this very wheel on any machine.

    Raises ValueError when the name is not a wheel's.
    """
    parts = file_name.removesuffix(".whl").split("-")
    python = re.fullmatch(r"cp(\d)(\d+)", parts[2]) if len(parts) == 5 and file_name.endswith(".whl") else None
    if python is None:
        raise ValueError(f"{file_name}: expected NAME-VERSION-cpXY-ABI-PLATFORM.whl")
    name, version, _, abi, platforms = parts
    arguments = [f"{name}=={version}", "--python-version", f"{python[1]}.{python[2]}", "--implementation", "cp", "--abi", abi]
    for platform in platforms.split("."):
        arguments += ["--platform", platform]
    return arguments


def fetch_wheels(source: Path) -> None:
    """Downloads the wheels that the manifest lists and the folder lacks; pip checks their hashes against PyPI's."""
    for path in read_manifest(source)["wheels"]:
        wheel = source / path
        if wheel.exists():
            continue
        wheel.parent.mkdir(exist_ok=True)
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:", "--dest", str(wheel.parent)]
        subprocess.run([*command, *pip_arguments_of_wheel(wheel.name)], check=True)
        if not wheel.exists():
            raise FileNotFoundError(f"{wheel.name}: pip fetched another file for this platform; list that one in {MANIFEST}")


def run_blender_ext(*arguments: str) -> None:
    """Runs Blender's extension builder of the installed bpy; it says itself what is wrong."""
    scripts = next(find_bpy_folder().glob("*/scripts"))
    tags = scripts / "modules/_bpy_internal/extensions/tags.py"
    command = [sys.executable, str(scripts / "addons_core/bl_pkg/cli/blender_ext.py"), *arguments, f"--valid-tags={tags}"]
    subprocess.run(command, check=True)


def check_contents(zip_path: Path) -> None:
    """Raises ValueError when a zip holds a file that is no part of the extension."""
    with zipfile.ZipFile(zip_path) as archive:
        strays = sorted({name for name in archive.namelist() if name.split("/")[0] not in ALLOWED_TOP})
    if strays:
        raise ValueError(f"{zip_path.name}: {', '.join(strays)} would be shipped; exclude it in {MANIFEST} or move it away")


def finish_zip(zip_path: Path) -> None:
    """Validates a zip that was built and says its size."""
    check_contents(zip_path)
    run_blender_ext("validate", str(zip_path))
    print(f"{zip_path}  {zip_path.stat().st_size / 1e6:.1f} MB")


def remove_zips(output: Path) -> None:
    """Deletes the zips of an earlier build."""
    for old_zip in output.glob("leaflight-*.zip"):
        old_zip.unlink()


def build_platform_zips(source: Path, output: Path) -> list[Path]:
    """One zip per platform, with that platform's wheels."""
    remove_zips(output)
    run_blender_ext("build", "--source-dir", str(source), "--output-dir", str(output), "--split-platforms")
    return sorted(output.glob("leaflight-*.zip"))


def replace_wheels(manifest_text: str, wheel_names: list[str]) -> str:
    """The manifest with another list of wheels and no list of platforms: it is for the machine at hand."""
    listed = "wheels = [\n" + "".join(f'  "./wheels/{name}",\n' for name in wheel_names) + "]"
    text, count = re.subn(r"^wheels = \[[^\]]*\]", lambda _: listed, manifest_text, flags=re.MULTILINE)
    if count != 1:
        raise ValueError(f"{MANIFEST}: expected one list of wheels, got {count}")
    return re.sub(r"^platforms = \[[^\]]*\]\n", "", text, flags=re.MULTILINE)


def build_local_zip(source: Path, platform_zip: Path, wheels_folder: Path) -> Path:
    """A zip beside a platform's zip, with the wheels of a folder instead.

    Raises ValueError when the folder has no wheels.
    """
    wheels = sorted(wheels_folder.glob("*.whl"))
    if not wheels:
        raise ValueError(f"{wheels_folder}: no wheels in it; put those of embreex and xatlas there")
    with tempfile.TemporaryDirectory() as temporary:
        stage = Path(temporary)
        with zipfile.ZipFile(platform_zip) as archive:
            archive.extractall(stage, [name for name in archive.namelist() if not name.startswith("wheels/")])
        (stage / "wheels").mkdir()
        for wheel in wheels:
            shutil.copy(wheel, stage / "wheels")
        # From the source: the builder refuses the notes it left in the zip's own manifest.
        manifest_text = (source / MANIFEST).read_text(encoding="utf-8")
        (stage / MANIFEST).write_text(replace_wheels(manifest_text, [wheel.name for wheel in wheels]), encoding="utf-8")
        zip_path = platform_zip.with_name(f"leaflight-{read_manifest(source)['version']}-local.zip")
        run_blender_ext("build", "--source-dir", str(stage), "--output-filepath", str(zip_path))
    return zip_path


def build_zips(source: Path, output: Path, wheels_folder: Path | None) -> None:
    """All zips, each validated; where one is not as it has to be none stays, for it looks like one to hand out."""
    try:
        zip_paths = build_platform_zips(source, output)
        if wheels_folder:
            zip_paths.append(build_local_zip(source, zip_paths[0], wheels_folder))
        for zip_path in zip_paths:
            finish_zip(zip_path)
    except (OSError, ValueError, subprocess.CalledProcessError):
        remove_zips(output)
        raise


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("dist"), help="folder of the zips")
    parser.add_argument("--wheels-dir", type=Path, help="also build one zip with the wheels of this folder")
    options = parser.parse_args(arguments)
    source = Path(__file__).resolve().parent.parent
    output: Path = options.output.resolve()
    output.mkdir(parents=True, exist_ok=True)
    try:
        fetch_wheels(source)
        build_zips(source, output, options.wheels_dir)
    except (OSError, ValueError) as reason:
        print(reason, file=sys.stderr)
        return 1
    except subprocess.CalledProcessError as failure:  # the command has said why
        return failure.returncode
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
