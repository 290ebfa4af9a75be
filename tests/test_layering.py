"""The order of the packages, and where outside libraries may be imported.

Each rule is a function from source text to a list of complaints, and each is shown a planted fault.
"""

import ast
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

# A package imports only from itself and from those before it.
ORDER = {
    "core": ["util", "parallel", "scene", "atlas", "texels", "lights", "transport", "radiosity", "filter", "integrate", "output", "bake"],
    "addon": ["nodes", "read", "show", "gltf", "app", "ui"],
}
# Each of these libraries has one home in core.
LIBRARY_HOME = {
    "embreex": "core.scene.rays",
    "xatlas": "core.atlas.xatlas_process",
    "OpenImageIO": "core.output.image_file",
    "distributed": "core.parallel.cluster",
}
BPY_FREE_ADDON = {
    "addon.app.arguments",
    "addon.app.bake_state",
    "addon.app.boot",
    "addon.app.console",
    "addon.app.estimate",
    "addon.app.job",
    "addon.app.quantities",
    "addon.app.words",
    "addon.gltf.gltf_file",
    "addon.show.bake_text",
    "addon.show.page_store",
    "addon.app.bake_bar",
}
PANELS = {"addon.ui.panels", "addon.ui.panels_object", "addon.ui.panel_parts", "addon.ui.panel_result"}
# The child's main program: it has no package, so it gives this folder the name leaflight and imports it by that.
NAMES_THE_PACKAGE = {"addon.app.boot"}

# Modules by their name inside the package ("core.scene.rays", "addon", "__main__"), with their source text.
Sources = dict[str, str]


def read_sources() -> Sources:
    """Every module of the package."""
    paths = [*ROOT.glob("*.py"), *ROOT.glob("core/**/*.py"), *ROOT.glob("addon/**/*.py")]
    return {_module_name(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in paths}


def _module_name(path: Path) -> str:
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)


def list_imports(module: str, sources: Sources, *, top_level_only: bool = False) -> set[str]:
    """What a module imports: names inside the package ("core.scene.rays") and top names of others ("numpy", "leaflight").

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


@cache  # the rules ask for each module again and again
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
        for_types_only = isinstance(child, ast.If) and isinstance(child.test, ast.Name) and child.test.id == "TYPE_CHECKING"
        if not for_types_only and not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
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
    # `from ..scene import rays` names a module; `from ..scene.rays import trace` a thing inside one.
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


def complain_of_order(sources: Sources) -> list[str]:
    """A package imports only from itself and from those before it in ORDER."""
    complaints = []
    for module in sorted(sources):
        top, package = (*module.split("."), "")[:2]
        if not package or top not in ORDER:
            continue
        order = ORDER[top]
        if package not in order:
            complaints.append(f"{module}: {top}/{package} has no place in the order of packages")
            continue
        for name in sorted(list_imports(module, sources)):
            other_top, other = (*name.split("."), "")[:2]
            if other_top == top and other in order and order.index(other) > order.index(package):
                complaints.append(f"{module} imports {name}: {package} comes before {other}")
    return complaints


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


def _modules_of(package: str, sources: Sources) -> list[str]:
    return sorted(module for module in sources if module.split(".")[0] == package)


RULES = [complain_of_order, complain_of_libraries, complain_of_addon, complain_of_absolute_imports]


@pytest.mark.parametrize("rule", RULES)
def test_package_keeps_the_rule(rule):
    sources = read_sources()
    assert {"__init__", "core.scene.scene", "core.util.settings", *BPY_FREE_ADDON, *PANELS, *LIBRARY_HOME.values()} <= sources.keys()
    assert rule(sources) == []


SOUND: Sources = {
    "__init__": "def register():\n    import bpy\n    from . import addon\n",
    "core": "",
    "core.util": "",
    "core.util.geometry": "import numpy",
    "core.scene": "",
    "core.scene.scene": "from __future__ import annotations\nimport json\nimport numpy as np\n",
    "core.scene.rays": "import embreex\nfrom ..util.geometry import normal\n",
    "core.radiosity": "",
    "core.radiosity.tally": "from ..scene.scene import SceneSnapshot",
    "core.bake": "",
    "core.bake.solve": "from ..scene import rays\nfrom ..radiosity import tally",
    "addon": "",
    "addon.app": "",
    "addon.app.job": "from ...core.util.messages import decode_message",
    "addon.show": "",
    "addon.show.images": "import bpy",
    "addon.ui": "",
    "addon.ui.panels": "import bpy\nfrom ..show import images",
}

# (rule, where a fault is planted, the fault, how the complaint begins)
FAULTS = [
    (complain_of_order, "core.scene.rays", "from ..radiosity.tally import deposit", "core.scene.rays imports core.radiosity"),
    (complain_of_order, "core.radiosity.tally", "def late():\n    from ..bake import solve", "core.radiosity.tally imports core.bake"),
    (complain_of_order, "addon.show.images", "from ..ui import panels", "addon.show.images imports addon.ui"),
    (complain_of_order, "core.unplaced.thing", "", "core.unplaced.thing: core/unplaced has no place"),
    (complain_of_libraries, "core.scene.scene", "import bpy", "core.scene.scene imports bpy"),
    (complain_of_libraries, "core.scene.scene", "def late():\n    from scipy.spatial import KDTree", "core.scene.scene imports scipy"),
    (complain_of_libraries, "core.scene.scene", "from ...addon.show import images", "core.scene.scene imports addon"),
    (complain_of_libraries, "core.scene.scene", "from ... import addon", "core.scene.scene imports __init__"),
    (
        complain_of_libraries,
        "core.radiosity.tally",
        "import embreex.rtcore_scene",
        "core.radiosity.tally imports embreex: only core.scene.rays",
    ),
    (
        complain_of_libraries,
        "core.scene.rays",
        "from importlib import import_module\nimport_module('xatlas')",
        "core.scene.rays imports xatlas",
    ),
    (
        complain_of_libraries,
        "core.bake.solve",
        "def late():\n    from distributed import Client",
        "core.bake.solve imports distributed: only",
    ),
    (complain_of_libraries, "core.scene.rays", "import OpenImageIO", "core.scene.rays imports OpenImageIO: only core.output.image_file"),
    (complain_of_addon, "addon.app.job", "import bpy", "addon.app.job reaches bpy"),
    (complain_of_addon, "addon.app.job", "def late():\n    import bpy.types", "addon.app.job reaches bpy"),
    (complain_of_addon, "addon.app.job", "from ..show.images import load", "addon.app.job reaches bpy"),
    (complain_of_addon, "addon", "from .show import images", "addon.app.job reaches bpy"),
    (complain_of_addon, "__init__", "import bpy", "__init__ reaches bpy"),
    (complain_of_addon, "__init__", "from .addon.show import images", "__init__ reaches bpy"),
    (complain_of_addon, "addon.ui.panels", "import numpy as np", "addon.ui.panels imports numpy"),
    (complain_of_absolute_imports, "addon.show.images", "from leaflight.core import scene", "addon.show.images imports leaflight"),
    (complain_of_absolute_imports, "core.radiosity.tally", "import leaflight", "core.radiosity.tally imports leaflight"),
]


@pytest.mark.parametrize("rule", RULES)
def test_rule_accepts_a_sound_package(rule):
    assert rule(SOUND) == []


@pytest.mark.parametrize(("rule", "module", "fault", "complaint"), FAULTS)
def test_rule_sees_a_planted_fault(rule, module, fault, complaint):
    assert any(found.startswith(complaint) for found in rule(SOUND | {module: fault}))
