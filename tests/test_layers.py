"""Who may import whom: arrows point down, package by package."""

import ast
from pathlib import Path

import controllers
import octarm

PACKAGE = Path(octarm.__file__).parent
CONTROLLERS = Path(controllers.__file__).parent

# From the bottom up: a package imports from itself and from those before it.
LAYERS = [
    "errors interrupts tolerances",
    "arrays bars files html memory palette",
    "formats importing units",
    "fields",
    "declared",
    "interfaces",
    "arm roll_off",
    "lagrange",
    "references",
    "disturbances metrics",
    "simulation",
    "runs",
    "recordings",
    "sweeps",
    "checks reports",
    "commands gym",
    "__init__ __main__",
]
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names.split()}


def imports(path: Path) -> set[str]:
    """Full names of the modules that a file imports, also inside functions."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} uses a relative import"
            names.add(node.module or "")
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def packages(names: set[str]) -> set[str]:
    """The parts of octarm among these names, one level below the top."""
    return {name.split(".")[1] for name in names if name.startswith("octarm.")}


def package_of(path: Path) -> str:
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


MODULES = {path: imports(path) for path in sorted(PACKAGE.rglob("*.py"))}


def test_imports_point_downwards():
    wrong = {}
    for path, names in MODULES.items():
        own = package_of(path)
        used = packages(names) & set(LEVEL)
        upwards = {name for name in used if name != own and LEVEL[name] >= LEVEL[own]}
        if upwards and own != "__init__":  # which hands names on
            wrong[path] = upwards
    assert wrong == {}


def importers(package: str) -> set[str]:
    """The packages of octarm that import another package."""
    tops = {path: {name.split(".")[0] for name in names} for path, names in MODULES.items()}
    return {package_of(path) for path, names in tops.items() if package in names}


def test_only_commands_know_the_controllers():
    assert importers("controllers") == {"commands", "gym"}


def test_only_recordings_know_rerun():
    assert importers("rerun") == {"recordings"}


def test_controllers_cannot_reach_the_plant():
    """A law knows the contract alone; what makes controllers, and proofs, know the model."""
    for path in sorted(CONTROLLERS.rglob("*.py")):
        names = imports(path)
        tops = {name.split(".")[0] for name in names}
        assert not tops & {"mujoco", "dm_control", "dm_env", "rerun"}, path
        allowed = {"interfaces", "arrays", "errors", "units"}
        if path == CONTROLLERS / "__init__.py":
            allowed |= {"arm", "declared", "roll_off"}
        elif path.parent.name == "proofs":
            allowed |= {"arm", "tolerances"}
        elif path.name == "gain_sets.py":
            allowed |= {"files", "formats"}
        assert packages(names) <= allowed, path
        if "arm" in allowed:
            assert "octarm.arm.mjcf" not in names, path


def test_the_analytic_model_never_sees_mujoco():
    top = {name.split(".")[0] for name in imports(PACKAGE / "arm" / "lagrange.py")}
    assert top <= {"__future__", "collections", "contextlib", "numpy", "octarm"}


def test_the_checkout_is_what_is_tested():
    root = Path(__file__).resolve().parent.parent
    assert PACKAGE == root / "octarm"
    assert CONTROLLERS == root / "controllers"
