"""Names what this machine lacks for pip's bpy, and the Debian package that has it, before an import fails with a traceback.

python tools/check_system.py --python    is this Python one that pip's bpy exists for? (before a virtual environment is made)
python tools/check_system.py             has the machine every shared library that the installed bpy links to?
python tools/check_system.py --packages  the same as the bare names of Debian packages, for `apt-get install`
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

BPY_PYTHONS = ((3, 11), (3, 13))

DEBIAN_PACKAGE = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libGLX.so.0": "libglx0",
    "libGLdispatch.so.0": "libglvnd0",
    "libICE.so.6": "libice6",
    "libOpenGL.so.0": "libopengl0",
    "libSM.so.6": "libsm6",
    "libX11.so.6": "libx11-6",
    "libXau.so.6": "libxau6",
    "libXcursor.so.1": "libxcursor1",
    "libXdmcp.so.6": "libxdmcp6",
    "libXext.so.6": "libxext6",
    "libXfixes.so.3": "libxfixes3",
    "libXi.so.6": "libxi6",
    "libXinerama.so.1": "libxinerama1",
    "libXrandr.so.2": "libxrandr2",
    "libXrender.so.1": "libxrender1",
    "libXt.so.6": "libxt6",
    "libXxf86vm.so.1": "libxxf86vm1",
    "libgcc_s.so.1": "libgcc-s1",
    "libgomp.so.1": "libgomp1",
    "libstdc++.so.6": "libstdc++6",
    "libuuid.so.1": "libuuid1",
    "libwayland-client.so.0": "libwayland-client0",
    "libxcb.so.1": "libxcb1",
    "libxkbcommon.so.0": "libxkbcommon0",
}


def list_missing_libraries(ldd_output: str) -> list[str]:
    """Names of the shared libraries that ldd did not find, each once, in ldd's order."""
    return list(dict.fromkeys(re.findall(r"^\s*(\S+) => not found", ldd_output, re.MULTILINE)))


def list_missing_versions(ldd_output: str) -> list[str]:
    """Symbol versions (GLIBC_2.38, ...) that this machine's libraries are too old for, each once, in ldd's order."""
    return list(dict.fromkeys(re.findall(r"version `(\S+)' not found", ldd_output)))


def describe_missing(ldd_output: str) -> list[str]:
    """One sentence per missing thing, with the command that mends it; empty when nothing is missing."""
    sentences = []
    for library in list_missing_libraries(ldd_output):
        package = DEBIAN_PACKAGE.get(library)
        remedy = f"apt-get install {package}" if package else f"install the package that has it (apt-file search {library})"
        sentences.append(f"bpy needs {library}, which this machine lacks: {remedy}")
    for version in list_missing_versions(ldd_output):
        sentences.append(f"bpy needs {version}, and this machine's library is older: use a newer system")
    return sentences


def list_packages(ldd_output: str) -> list[str]:
    """Debian packages of the missing libraries that have a known one."""
    return [DEBIAN_PACKAGE[library] for library in list_missing_libraries(ldd_output) if library in DEBIAN_PACKAGE]


def find_bpy_folder() -> Path:
    """The folder of the installed bpy, found without importing it.

    Raises FileNotFoundError when bpy is not installed.
    """
    spec = importlib.util.find_spec("bpy")
    if spec is None or spec.origin is None:
        raise FileNotFoundError(f"bpy is not installed for {sys.executable}: run pip install bpy")
    return Path(spec.origin).parent


def run_ldd(library: Path) -> str:
    """What ldd says about a shared library, with its complaints."""
    # LC_ALL: "not found" is looked for in English. ldd exits 1 when a symbol version is missing, which is one of our answers.
    result = subprocess.run(["ldd", str(library)], capture_output=True, text=True, check=False, env=os.environ | {"LC_ALL": "C"})
    return result.stdout + result.stderr


def check_python() -> int:
    """Exit code 1 with a sentence when pip has no bpy for the running Python."""
    if sys.version_info[:2] in BPY_PYTHONS:
        return 0
    wanted = " and ".join(f"{major}.{minor}" for major, minor in BPY_PYTHONS)
    print(f"bpy exists for Python {wanted}, this is {sys.version.split()[0]}: choose one with make PYTHON=python3.11", file=sys.stderr)
    return 1


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", action="store_true", help="check the Python version only")
    parser.add_argument("--packages", action="store_true", help="print the missing Debian packages only")
    options = parser.parse_args(arguments)
    if options.python:
        return check_python()
    if not sys.platform.startswith("linux"):
        return 0  # bpy's wheels for Windows and macOS bring all they need
    try:
        ldd_output = run_ldd(find_bpy_folder() / "__init__.so")
    except FileNotFoundError as reason:  # no bpy, or no ldd
        print(reason, file=sys.stderr)
        return 1
    if options.packages:
        print("\n".join(list_packages(ldd_output)))
        return 0
    sentences = describe_missing(ldd_output)
    packages = list_packages(ldd_output)
    if len(packages) > 1:
        sentences.append(f"All at once: apt-get install {' '.join(packages)}")
    print("\n".join(sentences), file=sys.stderr, end="\n" if sentences else "")
    return 1 if sentences else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
