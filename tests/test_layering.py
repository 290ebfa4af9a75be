"""The walls of the house: who may import whom, how long a file may be, and that every core module has its tests.

Each rule is a function from source text to a list of complaints, and each is shown a planted fault.
"""

from __future__ import annotations

import ast
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

CORE_MAX_LINES = 300
ADDON_MAX_LINES = 250

# Each of these libraries has one home in core.
LIBRARY_HOME = {"embreex": "core.rays", "xatlas": "core.xatlas_process", "OpenImageIO": "core.image_file", "distributed": "core.cluster"}
TRACE = {
    "core.photons",
    "core.births",
    "core.photons_ahead",
    "core.joined_emitters",
    "core.scene_cover",
    "core.sealed_solids",
    "core.rays",
    "core.lights",
    "core.emitters",
    "core.emitter_clusters",
    "core.emitting_cells",
    "core.slender_triangles",
    "core.mipmap",
    "core.geometry",
    "core.sampling",
    "core.direct",
    "core.direct_choice",
    "core.direct_crowd",
    "core.direct_environment",
    "core.environment",
    "core.environment_table",
    "core.sphere_map",
    "core.direct_lights",
    "core.direct_openings",
    "core.direct_peaks",
    "core.direct_points",
    "core.direct_pool",
    "core.direct_quads",
    "core.direct_sources",
    "core.direct_tally",
    "core.direct_tiles",
    "core.irradiance",
    "core.contact",
    "core.gather",
}
# core.materials and core.textures are on neither side: albedo and emission belong to the surface, photons and pages both ask for them.
STATISTICS = {
    "core.tally",
    "core.refine",
    "core.quadtree",
    "core.basis",
    "core.estimate",
    "core.missing_light",
    "core.photon_noise",
    "core.shrinkage",
}
# Where both sides meet: rounds of photons, shards that trace and sum them, and the whole bake.
SEES_ALL = {"core.solve", "core.workers", "core.photon_shards", "core.bake"}
BPY_FREE_ADDON = {
    "addon.arguments",
    "addon.bake_bar",
    "addon.bake_state",
    "addon.bake_text",
    "addon.boot",
    "addon.console",
    "addon.estimate",
    "addon.gltf_file",
    "addon.job",
    "addon.quantities",
    "addon.words",
}
PANELS = {"addon.panels", "addon.panels_object", "addon.panel_parts", "addon.panel_result"}
# The child's main program: it has no package, so it gives this folder the name leaflight and imports it by that.
NAMES_THE_PACKAGE = {"addon.boot"}

# Core modules whose tests are not in tests/unit/test_<module>.py.
TEST_HOME: dict[str, str] = {
    "core.direct_environment": "tests/unit/test_environment.py",
    "core.environment_table": "tests/unit/test_environment.py",
    "core.light_field": "tests/unit/test_solve.py",
    "core.sphere_map": "tests/unit/test_environment.py",
    "core.texel_map": "tests/unit/test_texels.py",
    "core.xatlas_process": "tests/unit/test_unfolding.py",
}

# Modules by their name inside the package ("core.rays", "addon", "__main__"), with their source text.
Sources = dict[str, str]


def read_sources() -> Sources:
    """Every module of the package."""
    paths = [*ROOT.glob("*.py"), *ROOT.glob("core/**/*.py"), *ROOT.glob("addon/**/*.py")]
    return {_module_name(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in paths}


def _module_name(path: Path) -> str:
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)


def list_imports(module: str, sources: Sources, *, top_level_only: bool = False) -> set[str]:
    """What a module imports: names inside the package ("core.rays") and top names of others ("numpy", "leaflight").

    `top_level_only` leaves out what functions import when they are called.
    """
    found: set[str] = set()
    for node in _find_imports(sources[module], top_level_only):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= _imported_names(module, node, sources)
        else:
            found |= {str(argument.value).split(".")[0] for argument in node.args[:1] if isinstance(argument, ast.Constant)}
    return found


@cache  # the rules ask of each module again and again
def _find_imports(source: str, top_level_only: bool) -> list[ast.Import | ast.ImportFrom | ast.Call]:
    """Statements that import, and calls that do."""
    return [
        node
        for node in _walk(ast.parse(source), top_level_only)
        if isinstance(node, ast.Import | ast.ImportFrom)
        or (isinstance(node, ast.Call) and _called_name(node) in ("import_module", "__import__"))
    ]


def _walk(tree: ast.AST, top_level_only: bool) -> list[ast.AST]:
    if not top_level_only:
        return list(ast.walk(tree))
    nodes: list[ast.AST] = []
    for child in ast.iter_child_nodes(tree):
        if not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            nodes += [child, *_walk(child, top_level_only)]
    return nodes


def _called_name(node: ast.Call) -> str:
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def _imported_names(module: str, node: ast.ImportFrom, sources: Sources) -> set[str]:
    if node.level == 0:
        return {str(node.module).split(".")[0]}
    package = [] if module in ("__init__", "__main__") else module.split(".")
    if not _is_package(module, sources):
        package = package[:-1]
    base = package[: len(package) - node.level + 1] + (node.module.split(".") if node.module else [])
    name = ".".join(base) or "__init__"
    # `from . import rays` names a module; `from .rays import trace` a thing inside one.
    inside = {".".join([*base, alias.name]) for alias in node.names}
    return {name} | (inside & sources.keys())


def _is_package(module: str, sources: Sources) -> bool:
    return any(other.startswith(f"{module}.") for other in sources)


def reach(module: str, sources: Sources, *, top_level_only: bool = False) -> set[str]:
    """All that a module imports, directly or through modules of the package, parent packages included."""
    seen: set[str] = set()
    to_visit = {module}
    while to_visit:
        current = to_visit.pop()
        seen.add(current)
        if current in sources:
            parents = {current.rpartition(".")[0]} & sources.keys()
            to_visit |= (list_imports(current, sources, top_level_only=top_level_only) | parents) - seen
    return seen - {module}


def complain_of_libraries(sources: Sources) -> list[str]:
    """Core imports numpy, the standard library and core; four libraries in one module each."""
    complaints = []
    for module in _modules_of("core", sources):
        for name in sorted(list_imports(module, sources)):
            if name.split(".")[0] in {"core", "numpy", *sys.stdlib_module_names} or LIBRARY_HOME.get(name) == module:
                continue
            home = LIBRARY_HOME.get(name)
            complaints.append(f"{module} imports {name}: " + (f"only {home} may" if home else "core is numpy and the standard library"))
    return complaints


def complain_of_trace_and_statistics(sources: Sources) -> list[str]:
    """Tracing never reaches statistics, nor the other way; only one module imports both."""
    complaints = []
    for module in _modules_of("core", sources):
        direct = list_imports(module, sources)
        if module in TRACE and (far := reach(module, sources) & STATISTICS):
            complaints.append(f"{module} traces and reaches {', '.join(sorted(far))}: trace never knows statistics")
        if module in STATISTICS and (far := reach(module, sources) & TRACE):
            complaints.append(f"{module} is statistics and reaches {', '.join(sorted(far))}: statistics never know rays")
        traced, counted = sorted(direct & TRACE), sorted(direct & STATISTICS)
        if traced and counted and module not in TRACE | STATISTICS | SEES_ALL:
            complaints.append(f"{module} imports both {traced} and {counted}: only {', '.join(sorted(SEES_ALL))} may")
    return complaints


def complain_of_addon(sources: Sources) -> list[str]:
    """Some modules must be importable without bpy, and panels without numpy."""
    complaints = []
    for module in sorted(BPY_FREE_ADDON & sources.keys()):
        if "bpy" in list_imports(module, sources) | reach(module, sources, top_level_only=True):
            complaints.append(f"{module} reaches bpy: it must run without Blender")
    if "bpy" in reach("__init__", sources, top_level_only=True):
        complaints.append("__init__ reaches bpy when it is imported: do it inside register()")
    for module in sorted(PANELS & sources.keys()):
        if "numpy" in list_imports(module, sources):
            complaints.append(f"{module} imports numpy: panels show what others computed")
    return complaints


def complain_of_absolute_imports(sources: Sources) -> list[str]:
    """Blender installs the package under another name, so it must never call itself by its own."""
    callers = [module for module in sources if module not in NAMES_THE_PACKAGE and "leaflight" in list_imports(module, sources)]
    return [f"{module} imports leaflight: write a relative import" for module in callers]


def complain_of_sizes(sources: Sources) -> list[str]:
    """Files stay short."""
    complaints = []
    for package, limit in (("core", CORE_MAX_LINES), ("addon", ADDON_MAX_LINES)):
        for module in _modules_of(package, sources):
            lines = len(sources[module].splitlines())
            if lines > limit:
                complaints.append(f"{module}: {lines} lines, the budget is {limit}")
    return complaints


def complain_of_missing_tests(sources: Sources, test_files: set[str]) -> list[str]:
    """Every core module has tests/unit/test_<module>.py or a listed home that exists."""
    complaints = []
    for module in _modules_of("core", sources):
        home = TEST_HOME.get(module, f"tests/unit/test_{module.removeprefix('core.')}.py")
        if module != "core" and home not in test_files:
            complaints.append(f"{module}: {home} does not exist")
    return complaints


def _modules_of(package: str, sources: Sources) -> list[str]:
    return sorted(module for module in sources if module.split(".")[0] == package)


def _list_test_files() -> set[str]:
    return {path.relative_to(ROOT).as_posix() for path in ROOT.glob("tests/**/test_*.py")}


RULES = [complain_of_libraries, complain_of_trace_and_statistics, complain_of_addon, complain_of_absolute_imports, complain_of_sizes]


@pytest.mark.parametrize("rule", RULES)
def test_package_keeps_the_rule(rule):
    sources = read_sources()
    assert {"__init__", "core.scene", "core.settings"} <= sources.keys()
    assert rule(sources) == []


def test_every_core_module_has_tests():
    assert complain_of_missing_tests(read_sources(), _list_test_files()) == []


def test_listed_test_homes_are_of_modules():
    assert set(TEST_HOME) <= set(read_sources())


SOUND: Sources = {
    "__init__": "def register():\n    import bpy\n    from . import addon\n",
    "core": "",
    "core.scene": "from __future__ import annotations\nimport json\nimport numpy as np\n",
    "core.rays": "import embreex\nfrom .geometry import normal\n",
    "core.geometry": "import numpy",
    "core.tally": "from .scene import SceneSnapshot",
    "core.solve": "from . import rays, tally",
    "addon": "",
    "addon.job": "from ..core.messages import decode_message",
    "addon.images": "import bpy",
    "addon.panels": "import bpy\nfrom . import images",
}

# (rule, where a fault is planted, the fault, how the complaint begins)
FAULTS = [
    (complain_of_libraries, "core.scene", "import bpy", "core.scene imports bpy"),
    (complain_of_libraries, "core.scene", "def late():\n    from scipy.spatial import KDTree", "core.scene imports scipy"),
    (complain_of_libraries, "core.scene", "from ..addon import images", "core.scene imports addon"),
    (complain_of_libraries, "core.scene", "from .. import addon", "core.scene imports __init__"),
    (complain_of_libraries, "core.tally", "import embreex.rtcore_scene", "core.tally imports embreex: only core.rays"),
    (complain_of_libraries, "core.rays", "from importlib import import_module\nimport_module('xatlas')", "core.rays imports xatlas"),
    (
        complain_of_libraries,
        "core.solve",
        "def late():\n    from distributed import Client",
        "core.solve imports distributed: only core.cluster",
    ),
    (complain_of_libraries, "core.rays", "import OpenImageIO", "core.rays imports OpenImageIO: only core.image_file"),
    (complain_of_trace_and_statistics, "core.rays", "from .tally import deposit", "core.rays traces and reaches core.tally"),
    (complain_of_trace_and_statistics, "core.rays", "from .scene import a\nfrom . import solve", "core.rays traces and reaches core.tally"),
    (complain_of_trace_and_statistics, "core.tally", "from . import geometry", "core.tally is statistics and reaches core.geometry"),
    (complain_of_trace_and_statistics, "core.scene", "from . import rays\nfrom . import tally", "core.scene imports both ['core.rays']"),
    (complain_of_addon, "addon.job", "import bpy", "addon.job reaches bpy"),
    (complain_of_addon, "addon.job", "def late():\n    import bpy.types", "addon.job reaches bpy"),
    (complain_of_addon, "addon.job", "from .images import load", "addon.job reaches bpy"),
    (complain_of_addon, "addon", "from . import images", "addon.job reaches bpy"),
    (complain_of_addon, "__init__", "import bpy", "__init__ reaches bpy"),
    (complain_of_addon, "__init__", "from .addon import images", "__init__ reaches bpy"),
    (complain_of_addon, "addon.panels", "import numpy as np", "addon.panels imports numpy"),
    (complain_of_absolute_imports, "addon.images", "from leaflight.core import scene", "addon.images imports leaflight"),
    (complain_of_absolute_imports, "core.tally", "import leaflight", "core.tally imports leaflight"),
    (complain_of_sizes, "core.tally", "\n" * (CORE_MAX_LINES + 1), "core.tally: 301 lines"),
    (complain_of_sizes, "addon.images", "\n" * (ADDON_MAX_LINES + 1), "addon.images: 251 lines"),
]


@pytest.mark.parametrize("rule", RULES)
def test_rule_accepts_a_sound_package(rule):
    assert rule(SOUND) == []


@pytest.mark.parametrize(("rule", "module", "fault", "complaint"), FAULTS)
def test_rule_sees_a_planted_fault(rule, module, fault, complaint):
    assert any(found.startswith(complaint) for found in rule(SOUND | {module: fault}))


def test_missing_tests_are_seen():
    test_files = {f"tests/unit/test_{name}.py" for name in ("scene", "rays", "geometry", "tally")}
    assert complain_of_missing_tests(SOUND, test_files) == ["core.solve: tests/unit/test_solve.py does not exist"]
