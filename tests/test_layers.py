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
    "options.argument",
    "options.run",
    "options.recordings",
    "options.sweeps",
    "options.checks",
    "options.tune",
    "options.machine",
    "options.table",
    "toml_table",
    "files",
    "arrays",
    "kinematics",
    "parameters",
    "interfaces",
    "report",
    "actuation",
    "lagrange",
    "effects.streams",
    "effects.fields",
    "effects.amplitude",
    "effects.episode",
    "effects.waves",
    "effects.forces",
    "effects.delays",
    "effects.actuators",
    "effects.sensors",
    "effects.plant_changes",
    "effects.drift",
    "effects.catalogue",
    "effects.acting",
    "disturbances",
    "model",
    "limits",
    "plant",
    "batch",
    "references",
    "environment",
    "measures.blocks",
    "measures.tracking",
    "measures.inputs",
    "measures.chattering",
    "measures.sliding",
    "metrics",
    "trajectory",
    "archive",
    "interrupts",
    "rollout",
    "tuning.space",
    "tuning.objective",
    "tuning.search",
    "effects.delivered",
    "ledger",
    "runs",
    "facts",
    "digest",
    "sweeps.spec",
    "sweeps.spelling",
    "sweeps.gain_sets",
    "sweeps.parser",
    "sweeps.plan",
    "sweeps.bar",
    "sweeps.shards",
    "sweeps.shard_file",
    "sweeps.under_way",
    "sweeps.folder",
    "sweeps.store",
    "sweeps.workers",
    "sweep",
    "reports.statistics",
    "reports.measures",
    "reports.episodes",
    "reports.findings",
    "reports.checks",
    "reports.panels",
    "reports.figures",
    "reports.tables",
    "reports.page",
    "checks.mechanics",
    "checks.free_motion",
    "validation",
    "recordings.scene",
    "recordings.channels",
    "recordings.states",
    "recordings.notes",
    "recordings.heat_map",
    "recordings.recorded_scene",
    "recordings.blueprints",
    "recordings.recorded_run",
    "recording",
    "recordings.comparison",
    "recordings.web_page",
    "recordings.viewer",
    "recordings.plots",
    "recordings.video",
    "experiment",
    "checks.machine",
    "checks.differences",
    "checks.verify",
    "checks.verify_episode",
    "sweeps.chosen",
    "sweeps.margin",
    "sweeps.margin_trial",
    "paper.effort",
    "paper.variants",
    "paper.studies",
    "paper.series",
    "paper.stability",
    "paper.load",
    "paper.shown",
    "paper.jobs",
    "paper.measured",
    "paper.claims",
    "paper.tables",
    "paper.evidence",
    "paper.quantities",
    "paper.overshoot",
    "paper.oscillation",
    "paper.chattering",
    "paper.premises",
    "paper.lyapunov",
    "paper.uncertainty",
    "paper.computation",
    "paper.verdicts",
    "paper.rankings",
    "paper.results",
    "paper.drawing",
    "paper.tracking",
    "paper.figures",
    "paper.writeup",
    "paper.page",
    "paper.output",
    "commands.summary",
    "commands.run",
    "commands.sweep",
    "commands.report",
    "commands.tune",
    "commands.verify",
    "commands.margin",
    "commands.replay",
    "commands.doctor",
    "options.words",
    "options.parser",
    "options.completion",
    "cli",
    "__main__",
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
    return {name.removeprefix("octarm.") for name in names if name.startswith("octarm.")} & set(
        ORDER
    )


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts)


def path_of(name: str) -> Path:
    return PACKAGE.joinpath(*name.split(".")).with_suffix(".py")


MODULES = [path for path in PACKAGE.rglob("*.py") if path.name != "__init__.py"]


def test_every_module_has_its_place():
    assert {name_of(path) for path in MODULES} == set(ORDER)


@pytest.mark.parametrize("name", ORDER)
def test_imports_point_downwards(name: str):
    allowed = set(ORDER[: ORDER.index(name)])
    assert modules_of(imports(path_of(name))) <= allowed


WITH_CONTROLLERS = (
    "commands.summary",
    "commands.run",
    "commands.sweep",
    "commands.report",
    "commands.tune",
    "commands.verify",
    "commands.margin",
    "options.words",
    "cli",
)


@pytest.mark.parametrize("name", [n for n in ORDER if n not in WITH_CONTROLLERS])
def test_octarm_does_not_import_controllers(name: str):
    assert not any(m.split(".")[0] == "controllers" for m in imports(path_of(name)))


def test_only_what_makes_recordings_imports_rerun():
    users = {name_of(p) for p in MODULES if any("rerun" in m for m in imports(p))}
    parts = {"recorded_run", "recorded_scene", "heat_map", "blueprints", "comparison"}
    assert users == {"recording", *(f"recordings.{part}" for part in parts)}


def test_the_analytic_model_never_sees_mujoco():
    top = {name.split(".")[0] for name in imports(PACKAGE / "lagrange.py")}
    assert top <= {"__future__", "collections", "contextlib", "numpy", "octarm"}
    assert modules_of(imports(PACKAGE / "lagrange.py")) <= {"arrays", "kinematics", "parameters"}


@pytest.mark.parametrize("path", sorted(CONTROLLERS.glob("*.py")), ids=lambda p: p.stem)
def test_controllers_cannot_reach_the_plant(path: Path):
    names = imports(path)
    top = {name.split(".")[0] for name in names}
    assert not top & {"mujoco", "dm_control", "dm_env", "rerun"}
    assert modules_of(names) <= {
        "interfaces",
        "kinematics",
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
