"""octarm arm: what the numbers of an arm mean; arms in all commands that run one."""

import dataclasses
import io
import json
import re
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pytest

import octarm
from octarm.arm import lagrange
from octarm.arm.actuation import GroundedActuation
from octarm.arm.file import Arm
from octarm.arm.modes import modes, rates
from octarm.arm.parameters import ArmParameters
from octarm.arm.reach import hold, reach
from octarm.arm.rod import Rod, arm_from_rod
from octarm.arm.summary import ArmSummary
from octarm.checks.validation import random_arm
from octarm.commands.cli import main
from octarm.reports.arm_figures import arm_figure

P = octarm.nominal_parameters()

FILE = """\
mass = { value = [300, 200], unit = "g" }
inertia = "600 kg mm^2"
width = "80 mm"
rest_length = "12 cm"
stiffness = "1.2 N/mm"
damping = "12 N s/m"
input_range = { value = [-50, 50], unit = "N" }
"""


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text(FILE, encoding="utf-8")


def said(*words: str, code: int = 0) -> str:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        assert main(words) == code, err.getvalue()
    return out.getvalue() + err.getvalue()


# How far an arm bends


@pytest.mark.parametrize("limits", [(-12.0, 12.0), (0.0, 20.0), (-3.0, 40.0)])
@pytest.mark.parametrize("modules", [1, 3, 6])
def test_the_largest_bends_are_held_by_inputs_at_their_limits(modules: int, limits):
    arm = dataclasses.replace(arm_from_rod(Rod(), modules), input_range=limits)
    held = reach(arm)
    bends = np.concatenate([np.diag(held.alone[1]), held.alike[1] * np.ones((1, modules))])
    for share, good in ((1.0, True), (1.001, False)):
        within, q = hold(arm, share * bends)
        assert np.all(within == good)
        tau = GroundedActuation(arm.widths).inputs(q, lagrange.potential_force(arm, q))
        room = np.minimum(tau - limits[0], limits[1] - tau).min(axis=-1)
        if good:
            assert np.all(room > -1e-6)
            assert np.all(room < 0.01 * (limits[1] - limits[0]))


def test_the_last_module_bends_by_its_couple_over_its_stiffness():
    """k theta = l/2 (tau_1 - tau_2), since no weight is beyond it; both of its sides alike."""
    arm = dataclasses.replace(P, input_range=(-12.0, 12.0))
    stiffness = lagrange.stiffness_matrix(arm)[-1, -1]
    np.testing.assert_allclose(reach(arm).alone[:, -1] * stiffness, [-0.96, 0.96], rtol=1e-3)


def test_without_a_range_an_arm_bends_as_far_as_one_likes():
    arm = dataclasses.replace(P, input_range=(-np.inf, np.inf))
    assert np.all(np.abs(reach(arm).alone) == 2.0 * np.pi)


# Modes


@pytest.mark.parametrize("modules", [1, 3, 5])
def test_modes_are_those_of_the_linearised_arm(modules: int):
    """With dampers in proportion to springs, each mode has its pair of eigenvalues."""
    arm = arm_from_rod(Rod(damping_time=0.003, gravity=0.0), modules)
    rest = lagrange.equilibrium(arm)
    pairs = []
    for mode in modes(arm, rest):
        w, z = 2.0 * np.pi * mode.frequency, mode.damping_ratio
        pairs += [-z * w + w * np.emath.sqrt(z * z - 1.0), -z * w - w * np.emath.sqrt(z * z - 1.0)]
        assert mode.slides in (pytest.approx(0.0, abs=1e-9), pytest.approx(1.0, abs=1e-9))
    ordered = [np.sort_complex(np.asarray(x, dtype=complex)) for x in (pairs, rates(arm, rest))]
    np.testing.assert_allclose(*ordered, rtol=1e-6)


def test_a_mode_that_grows_has_no_frequency():
    standing = dataclasses.replace(P, gravity=-120.0)
    first, *_ = modes(standing, lagrange.equilibrium(standing))
    assert np.isnan(first.frequency)
    lines = "\n".join(ArmSummary.of(Arm(standing)).lines())
    assert "grows" in lines and "it does not stay where it hangs" in lines


# The command


def test_it_says_what_an_arm_is():
    text = said("arm", "mine.toml")
    assert "arm: 2 modules, 0.24 m, 0.5 kg" in text
    assert re.search(r"^2 +120 +0\.2 +0\.0006 +80 +2400 +3\.84 +24 +0\.0384$", text, re.M)
    assert "input range of the columns: -50 .. 50 N" in text
    for word in ("frequency [Hz]", "longest stable physics step: rk4 ", "condition", "theta2 +-"):
        assert word in text
    assert "source: " in said("arm", "eth") and "assumed: " in said("arm", "eth")
    assert said("arm", "eth", "mine.toml").count("longest stable") == 2


@pytest.mark.parametrize("modules", [1, 20])
def test_arms_of_any_size_are_said_and_drawn(modules: int):
    arm = random_arm(np.random.default_rng(modules), modules)
    summary = ArmSummary.of(Arm(arm, "an arm \x1b[31m"))
    text = "\n".join(summary.lines())
    assert "\x1b" not in text
    assert max(map(len, text.splitlines())) < 200
    assert arm_figure(summary).png.startswith(b"\x89PNG")
    assert f"{modules} module" in arm_figure(summary).svg


def test_a_rod_is_written_as_a_file_that_reads_as_the_same_arm():
    rod = "length=.36,EA=240,EI=.384:.2,density=2,modules=9,layout=centred"
    first = said("arm", "--from-rod", rod, "--write", "rod.toml", "--out", "rod.png")
    assert Path("rod.png").read_bytes().startswith(b"\x89PNG")
    written = octarm.read_arm("rod.toml")
    expected = octarm.arm_from_rod(
        octarm.Rod(length=0.36, EA=240.0, EI=(0.384, 0.2), density=2.0), 9, "centred"
    )
    for field in dataclasses.fields(ArmParameters):
        a, b = getattr(written, field.name), getattr(expected, field.name)
        np.testing.assert_allclose(a, b, rtol=1e-11)
    again = said("arm", "rod.toml").splitlines()
    assert again == first.splitlines()[: len(again)]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--from-rod", "EA=3"], "--from-rod is 'EA=3'; it needs modules=N, a whole number"),
        (["--from-rod", "modules=x"], "modules of 'modules=x' is 'x'; it must be a number"),
        (["--from-rod", "modules=3,EE=2"], "has no key 'EE'; known are length, EA, EI, density"),
        (["--from-rod", "modules=3,EA=-1"], "EA holds -1; it must be finite and above 0"),
        (["--from-rod", "modules=3,EA=1:x"], "EA of 'modules=3,EA=1:x' is '1/x'; its unit must be"),
        (["--from-rod", "modules=3,modules=3"], "'modules=3,modules=3' gives modules twice"),
        (["--from-rod", "modules=3,EA=1e-3"], "cannot hang in one piece: at rest s1 is"),
        (["eth", "--from-rod", "modules=3"], "--from-rod is given, and so is 'eth'"),
        (["eht"], "unknown arm 'eht', did you mean 'eth'? known are eth, fabric, i-support, oct"),
        (["none.toml"], "none.toml cannot be read"),
        (["eth", "fabric", "--out", "x.png"], "2 arms are given; --write and --out take one"),
        (["--controller", "smc-bundary"], "did you mean 'smc-boundary'"),
        (["--controller", "pd", "--control-period", "0"], "control period is 0 s; it must be"),
    ],
)  # fmt: skip
def test_what_cannot_be_meant_is_refused_in_a_sentence(words: list[str], sentence: str):
    text = said("arm", *words, code=2)
    assert sentence in text
    assert text.splitlines()[-1].startswith("octarm: ")


def test_it_says_whether_loops_are_stable():
    text = said(
        "arm",
        "--controller",
        "pd",
        "--controller",
        "smc",
        "--controller",
        "afsmc",
        "--gains",
        "recommended",
    )
    assert re.search(r"^pd +[\d.]+ ms +[\d.]+ +\w+\d, alternates at [\d.]+ Hz; mode", text, re.M)
    assert re.search(r"^smc +no derivative by measurements at rest", text, re.M)
    slow = ["--gains", "recommended", "--control-period", "0.1"]
    said("arm", "--controller", "pd", *slow, code=1)


def test_it_says_so_of_a_finer_plant_and_of_a_roll_off():
    words = ["--controller", "smc-boundary", "--gains", "recommended"]
    plant = [*words, "--plant-modules", "9", "--layout", "centred", "--control-period", "0.0005"]
    text = said("arm", *plant, "--roll-off", "60")  # in Hz
    assert "the model exact, on a plant of 9 modules (centred)" in text
    held = [
        float(re.findall(r"^smc-boundary +([\d.]+) ms", x, re.M)[0])
        for x in (text, said("arm", *plant, code=1), said("arm", *words))
    ]
    assert held[0] > 2.0 * held[1] and held[2] > 5.0 * held[1]
    assert "roll_off holds 0" in said("arm", *words, "--roll-off", "0", code=2)
    assert "must be a multiple" in said("arm", *words, "--plant-modules", "10", code=2)
    assert "--roll-off is given without --controller" in said("arm", "--roll-off", "60", code=2)
    assert "--layout is given without" in said("arm", "--layout", "centred", code=2)


# Arms in other commands


def test_a_run_has_the_arm_of_its_file_and_parameters_on_top():
    words = ["--arm", "mine.toml", "--controller", "pd", "--duration", "0.02"]
    said("run", *words, "--parameter", "gravity:3", "--out", "run")
    told = json.loads(Path("run/run.json").read_text(encoding="utf-8"))
    assert told["parameters"]["mass"] == [0.3, 0.2]
    assert told["parameters"]["gravity"] == 3.0
    assert told["nominal"]["input_range"] == [[-50.0], [50.0]]
    assert "backbone_stiffness" not in told["parameters"]
    said("run", "--arm", "eth", "--controller", "pd", "--duration", "0.02", "--out", "eth")
    assert "identical" in said("verify", "eth")


@pytest.mark.slow
def test_a_sweep_over_arms_keeps_them_and_gives_each_its_columns():
    spec = """\
episodes = 2
duration = 2.6
controller = "pd"
control_period = 0.001
[grid]
arm = ["mine.toml", "fabric", "octarm"]
[random.disturbance]
payload = { low = 0.0, high = 0.02 }
"""
    Path("spec.toml").write_text(spec, encoding="utf-8")
    said("sweep", "spec.toml", "--out", "sweep", "--workers", "1")
    table = octarm.read_sweep("sweep").to_pydict()
    assert table["arm"] == [name for name in ("mine.toml", "fabric", "octarm") for _ in range(2)]
    missing = [x is None for x in table["rms_error_s2"]]
    assert missing == [False, False, True, True, False, False]
    assert [x is None for x in table["rms_error_s3"]] == [True] * 4 + [False] * 2
    Path("mine.toml").unlink()  # the kept spec has all its numbers
    kept = octarm.read_spec("sweep/spec.toml")
    assert kept.arm("mine.toml").mass.tolist() == [0.3, 0.2]
    np.testing.assert_array_equal(
        kept.arm("fabric").backbone_stiffness, octarm.read_arm("fabric").backbone_stiffness
    )
    assert said("verify", "sweep", "--episode", "1", "--episode", "3").count("identical") == 2
    said("report", "sweep")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('arm = "eht"', "line 2: unknown arm 'eht', did you mean 'eth'"),
        ('arm = "none.toml"', "line 2: none.toml cannot be read"),
        ('arm = "eth"\n[grid]\narm = ["fabric"]', "arm is given twice, here and elsewhere"),
        ("[arm]\nmass = 3", "line 3: mass is 3; it must be given with a unit, such as"),
        ('arm = "eth"\n[arms.fabric]\nmass = [1]', "'fabric' is no arm of this sweep"),
        ('arm = "eth"\nplant_modules = 3', "it must be a multiple of the arm's 2"),
    ],
)
def test_a_wrong_arm_of_a_sweep_is_refused(text: str, sentence: str):
    Path("spec.toml").write_text(f'controller = "pd"\n{text}\n', encoding="utf-8")
    with pytest.raises(octarm.errors.OctarmError) as caught:  # pyright: ignore
        octarm.read_spec("spec.toml")
    assert sentence in str(caught.value)


def test_a_spec_may_hold_the_arm_itself():
    Path("spec.toml").write_text(f'controller = "pd"\nduration = 0.01\n[arm]\n{FILE}', "utf-8")
    said("sweep", "spec.toml", "--out", "sweep", "--workers", "1")
    assert octarm.read_sweep("sweep").to_pydict()["arm"] == ["arm"]
    assert octarm.read_spec("sweep/spec.toml").arm("arm").modules == 2


def test_a_margin_and_a_check_take_an_arm():
    text = said(
        "margin", "pd", "--arm", "fabric", "--disturbance", "payload", "--bound",
        "rms_error_theta1:0.3", "--seeds", "1", "--settle", "0.1", "--duration", "0.2",
        "--high", "0.01",
    )  # fmt: skip
    assert "--arm=fabric" in text
    assert said("validate", "--arm", "mine.toml", "--modules", "4", code=2)
