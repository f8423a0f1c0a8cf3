"""Who may import whom."""

import ast
from pathlib import Path

import pytest

import controllers
import octarm

PACKAGE = Path(octarm.__file__).parent
CONTROLLERS = Path(controllers.__file__).parent

# From the bottom up: a module imports only from those above it in this list.
ORDER = [
    "errors",
    "toml_table",
    "files",
    "arrays",
    "parameters",
    "interfaces",
    "report",
    "actuation",
    "lagrange",
    "streams",
    "fields",
    "episode",
    "forces",
    "actuators",
    "sensors",
    "plant_changes",
    "disturbances",
    "model",
    "limits",
    "plant",
    "batch",
    "references",
    "environment",
    "blocks",
    "tracking_metrics",
    "input_metrics",
    "chattering",
    "sliding_metrics",
    "metrics",
    "trajectory",
    "rollout",
    "search_space",
    "objective",
    "tuning",
    "ledger",
    "runs",
    "facts",
    "digest",
    "sweep_spec",
    "sweep_parser",
    "sweep_plan",
    "shards",
    "sweep_folder",
    "workers",
    "sweep",
    "statistics",
    "sweep_measures",
    "sweep_episodes",
    "sweep_report",
    "sweep_checks",
    "sweep_panels",
    "sweep_figures",
    "report_tables",
    "report_page",
    "mechanics",
    "free_motion",
    "validation",
    "scene",
    "channels",
    "states",
    "notes",
    "heat_map",
    "recorded_scene",
    "blueprints",
    "recorded_run",
    "recording",
    "comparison",
    "web_page",
    "viewer",
    "plots",
    "video",
    "experiment",
    "differences",
    "verify",
    "verify_episode",
    "chosen",
    "margin",
    "margin_trial",
    "summary",
    "commands",
    "sweep_commands",
    "report_commands",
    "tune_commands",
    "verify_commands",
    "margin_commands",
    "replay_commands",
    "cli",
]


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


def modules_of(names: set[str]) -> set[str]:
    return {name.split(".")[1] for name in names if name.startswith("octarm.")} & set(ORDER)


def test_every_module_has_its_place():
    found = {path.stem for path in PACKAGE.glob("*.py")} - {"__init__"}
    assert found == set(ORDER)


@pytest.mark.parametrize("name", ORDER)
def test_imports_point_downwards(name: str):
    allowed = set(ORDER[: ORDER.index(name)])
    lazily = {"commands": set(), "cli": {"commands"}}.get(name, set())
    assert modules_of(imports(PACKAGE / f"{name}.py")) - {"cli"} <= allowed | lazily


WITH_CONTROLLERS = (
    "summary",
    "commands",
    "sweep_commands",
    "report_commands",
    "tune_commands",
    "verify_commands",
    "margin_commands",
    "cli",
)


@pytest.mark.parametrize("name", [n for n in ORDER if n not in WITH_CONTROLLERS])
def test_octarm_does_not_import_controllers(name: str):
    assert not any(m.split(".")[0] == "controllers" for m in imports(PACKAGE / f"{name}.py"))


def test_only_what_makes_recordings_imports_rerun():
    users = {p.stem for p in PACKAGE.glob("*.py") if any("rerun" in m for m in imports(p))}
    parts = {"recorded_run", "recorded_scene", "heat_map", "blueprints", "comparison"}
    assert users == {"recording", *parts}


def test_the_analytic_model_never_sees_mujoco():
    top = {name.split(".")[0] for name in imports(PACKAGE / "lagrange.py")}
    assert top <= {"__future__", "collections", "contextlib", "numpy", "octarm"}
    assert modules_of(imports(PACKAGE / "lagrange.py")) <= {"arrays", "parameters"}


@pytest.mark.parametrize("path", sorted(CONTROLLERS.glob("*.py")), ids=lambda p: p.stem)
def test_controllers_cannot_reach_the_plant(path: Path):
    names = imports(path)
    top = {name.split(".")[0] for name in names}
    assert not top & {"mujoco", "dm_control", "dm_env", "rerun"}
    assert modules_of(names) <= {
        "interfaces",
        "lagrange",
        "parameters",
        "arrays",
        "errors",
        "report",
    }


def test_the_checkout_is_what_is_tested():
    root = Path(__file__).resolve().parent.parent
    assert PACKAGE == root / "octarm"
    assert CONTROLLERS == root / "controllers"
