"""Numbers with units: on the command line, in disturbances and in specs."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import octarm
from controllers import make_controller
from octarm.arm.file import read_arm
from octarm.arm.mjcf import nominal_parameters
from octarm.commands.cli import main
from octarm.commands.options import ArmOptions
from octarm.disturbances.spelling import parse_disturbance, spelling
from octarm.disturbances.varied import parse_varied
from octarm.errors import OctarmError
from octarm.fields import Quantity
from octarm.metrics.table import parse_bound
from octarm.recordings.comparison import differences
from octarm.recordings.words import notes_of, short_title_of
from octarm.references import parameters_of
from octarm.references.samples import samples_end
from octarm.runs.folder import read_description
from octarm.sweeps.spec_file import parse_spec
from octarm.units import ANY, number


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("10", "s", 10.0),
        ("10s", "s", 10.0),
        ("60ms", "s", 0.06),
        ("1.5 min", "s", 90.0),
        ("40%", "1", 0.4),
        ("-30 %", "1", -0.3),
        ("100g", "kg", 0.1),
        ("15deg", "rad", math.radians(15.0)),
        ("2e3mN", "N or N m", 2.0),
        ("5 N mm", "N or N m", 0.005),
        ("3 Nm", "N or N m", 3.0),
        ("10%/s", "1/s", 0.1),
        ("4kN/s", "N/s", 4000.0),
        ("1e-3", "1/s", 1e-3),
        ("inf", "N", math.inf),
        ("5mm", ANY, 0.005),
        ("15°", "rad", math.radians(15.0)),
        ("60 µs", "s", 60e-6),
        ("60\u03bcs", "s", 60e-6),
    ],
)
def test_a_number_is_converted_to_the_unit_of_the_program(text: str, unit: str, value: float):
    assert number("x", text, unit) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize("text", ["", "some", "1.5.1", "1e", "s", "0x10", "1,5", "--3%"])
def test_what_is_no_number_is_refused(text: str):
    with pytest.raises(OctarmError, match=r"^x is .*; it must be a number$"):
        number("x", text, "s")


def test_the_unit_of_another_quantity_is_refused():
    with pytest.raises(OctarmError, match=r"^x is '10kg'; its unit must be s, ms, us or min$"):
        number("x", "10kg", "s")
    with pytest.raises(OctarmError, match="'3 Mn'; its unit must be N, mN, kN, N m or N mm"):
        number("x", "3 Mn", "N or N m")


def test_disturbances_take_units_and_keep_si():
    assert spelling(parse_disturbance("payload:100g,at=500ms")) == "payload:0.1,at=0.5"
    assert spelling(parse_disturbance("loss:0/50%/0.5/0/0/0")) == "loss:0/0.5/0.5/0/0/0"
    assert spelling(parse_disturbance("slew:4kN/s")) == "slew:4000"
    assert spelling(parse_disturbance("drift:10%/s,of=damping")).startswith("drift:0.1,of=damping")
    with pytest.raises(OctarmError, match="mass of 'payload:3s' is '3s'; its unit must be kg or g"):
        parse_disturbance("payload:3s")


def test_a_margin_is_sought_between_numbers_with_units():
    varied = parse_varied("actuation-delay", "0ms", "60ms")
    assert (varied.low, varied.high) == (0.0, 0.06)
    assert parse_bound("tip_rms_error:10mm") == ("tip_rms_error", 0.01)
    assert parse_bound("rms_error_theta1:2deg")[1] == pytest.approx(math.radians(2.0))
    heavy = parse_varied("payload:at=1", None, "100kg")  # meant
    assert heavy.high == 100.0 and heavy.of(np.ones(1))
    with pytest.raises(OctarmError, match="high is 100 kg; it must be at most 20 kg unless"):
        parse_varied("payload", None, "100")
    with pytest.raises(OctarmError, match="'5kg'; its unit must be m, cm, mm or um"):
        parse_bound("tip_rms_error:5kg")
    with pytest.raises(OctarmError, match="high is '60g'; its unit must be s, ms, us or min"):
        parse_varied("actuation-delay", None, "60g")


SPEC = """
duration = "4000 ms"
timestep = "250us"
[grid]
controller = ["pd"]
mismatch = ["-30%", 0.0]
[grid.disturbance]
noise = [0, "40%"]
[random.disturbance]
tilt = {low = 0.0, high = "15deg"}
[disturbance]
payload = {mass = "100g", at = "1 s"}
loss = [0, 0, "50%", 0, 0, 0]
"""


def test_a_spec_takes_units():
    spec = parse_spec(SPEC)
    assert (spec.duration, spec.timestep) == (4.0, 0.00025)
    values = {axis.name: axis.values for axis in (*spec.axes, *spec.random)}
    assert values["mismatch"] == (-0.3, 0.0)
    assert values["noise"] == (0.0, 0.4)
    assert values["tilt"] == (0.0, pytest.approx(math.radians(15.0)))
    assert spec.fixed["payload"] == {"mass": 0.1, "at": 1.0}
    assert list(spec.fixed["loss"]["share"]) == [0.0, 0.0, 0.5, 0.0, 0.0, 0.0]
    with pytest.raises(OctarmError, match=r"spec.toml, line 2: duration is '4 kg'; its unit must"):
        parse_spec(SPEC.replace("4000 ms", "4 kg"))
    with pytest.raises(OctarmError, match=r"line 8: grid.disturbance.noise is '40x'; its unit"):
        parse_spec(SPEC.replace("40%", "40x"))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("tilt:200deg", "angle of 'tilt:200deg' is 200deg; it must be at most 180deg"),
        ("payload:-50g", "mass of 'payload:-50g' is -50g; it must be at least 0 kg"),
        ("actuation-delay:20000ms", "is 20000ms; it must be at most 10000ms"),
        ("loss:0/0/150%/0/0/0", "is 150%; it must be at most 100%"),
        ("noise:.4,time=-1 ms", "is -1 ms; it must be above 0 s"),
    ],
)
def test_an_error_repeats_the_value_as_it_was_typed(text: str, sentence: str):
    with pytest.raises(OctarmError, match=re.escape(sentence)):
        parse_disturbance(text)


@pytest.mark.parametrize(
    ("text", "sentence", "exact"),
    [
        ("payload:100", "is 100 kg; it must be at most 20 kg .*, did you mean 100g", "100kg"),
        ("noise:40", "is 40; it must be at most 20 .*, did you mean 40%", "4000%"),
        ("lag:60", "is 60 s; it must be at most 10 s .*, did you mean 60ms", "60s"),
        ("step:1e9", r"is 1e\+09 N or N m; it must be at most 10000 N or N m .*1e\+09N$", "1e9N"),
        ("step:-1e9", r"it must be at least -10000 N or N m", "-1e9N"),
        ("mismatch:30", "it must be at most 10 .*, did you mean 30%", "3000%"),
        ("drift:20", "is 20 1/s; .* at most 10 1/s unless .* 20/s, did you mean 20%/s", "20/s"),
    ],
)
def test_a_size_that_is_not_plausible_needs_its_unit(text: str, sentence: str, exact: str):
    with pytest.raises(OctarmError, match=sentence):
        parse_disturbance(text)
    name = text.partition(":")[0]
    assert parse_disturbance(f"{name}:{exact}")
    table = f"[disturbance]\n{name} = {text.partition(':')[2]}"
    with pytest.raises(OctarmError, match=f"line 4: .*{sentence}"):
        parse_spec(f"[grid]\ncontroller = ['pd']\n{table}")


def test_what_is_not_allowed_may_have_been_meant_in_a_smaller_unit():
    for text, meant in (("loss:40", "40%"), ("actuation-delay:60", "60ms")):
        with pytest.raises(OctarmError, match=f"did you mean {meant}"):
            parse_disturbance(text)
    with pytest.raises(OctarmError, match="in degrees it is spelt 90deg"):
        parse_disturbance("tilt:90")
    with pytest.raises(OctarmError, match="did you mean 20mm"):
        parameters_of("sine-slides:20")
    with pytest.raises(OctarmError, match="did you mean -30%"):
        nominal_parameters().mismatched(-30.0)


def test_a_field_of_a_user_states_what_is_plausible():
    gust = Quantity("N", plausible=50.0)
    assert gust.parse("gust", "40") == 40.0 and gust.parse("gust", "60N") == 60.0
    with pytest.raises(OctarmError, match="gust is 60 N; it must be at most 50 N unless"):
        gust.parse("gust", "60")
    assert Quantity("furlong").parse("way", "1e9") == 1e9
    assert Quantity("furlong").parse("way", "3 furlong") == 3.0


def test_gains_have_units():
    def gain(law: str, name: str, value: object) -> np.ndarray:
        made = make_controller(law, nominal_parameters(), {name: value})
        return np.asarray(getattr(made, {"lambda": "lambda_"}.get(name, name)))

    assert gain("smc", "lambda", "15/s") == 15.0
    assert gain("smc-boundary", "phi", "3deg/s") == pytest.approx(math.radians(3.0))
    assert gain("super-twisting", "k_1", "3N/sqrt(m/s)") == 3.0
    assert gain("pd", "roll_off", "20Hz") == 20.0
    assert gain("smc", "uncertainty", "30%") == 0.3
    listed = ["1.6N", "1000mN", 0.8, "400 N mm", "0.25Nm", 0.03]
    np.testing.assert_allclose(gain("smc", "K", listed), [1.6, 1.0, 0.8, 0.4, 0.25, 0.03])
    with pytest.raises(OctarmError, match=r"K is .*; its unit must be N, mN or kN"):
        gain("smc", "K", ["1.6N m", 1, 1, 1, 1, 1])
    with pytest.raises(OctarmError, match="lambda is '15N'; its unit must be 1/s or %/s"):
        gain("smc", "lambda", "15N")
    spec = parse_spec("[grid]\ncontroller = ['pd']\n[gains.pd]\nK_p = '5 N/mm'")
    made: Any = spec.controller("pd", nominal_parameters(), make_controller)
    assert np.all(made.K_p == 5000.0)


def test_a_file_of_gains_may_hold_some_in_si():
    content = {"controller": "pd", "gains": {"K_p": 1.0, "K_d": "8 N s/m"}, "arm": {}}
    made: Any = make_controller("pd", nominal_parameters(), gain_set=content)
    assert np.all(made.K_d == 8.0) and not np.all(made.K_p == 1.0)


def test_parameters_of_the_arm_have_units():
    options = ArmOptions(
        parameter=("mass:300g,250g,200g", "input_range:-12N,inf", "stiffness:1.2N/mm"),
        nominal=("mass:70%",),
    )
    true, nominal = options.both()
    np.testing.assert_allclose(true.mass, [0.3, 0.25, 0.2])
    np.testing.assert_allclose(nominal.mass, 0.7 * true.mass)
    assert np.all(true.stiffness == 1200.0) and np.ravel(true.input_range)[0] == -12.0
    for word, sentence in (
        ("mass:300,250,200", "mass of --parameter is 300 kg; .* did you mean 300g"),
        ("mass:3s", "its unit must be kg or g"),
        ("mass:30,25,20g", "each number needs its unit"),
    ):
        with pytest.raises(OctarmError, match=sentence):
            ArmOptions(parameter=(word,)).true_arm()
    with pytest.raises(OctarmError, match="mass of --nominal is '70g'; its unit must be %"):
        ArmOptions(nominal=("mass:70g",)).factors()


def test_load_takes_spellings_as_well():
    environment = octarm.load(disturbances=["payload:100g", parse_disturbance("tilt:15deg")])
    assert environment.task.disturbances[0].mass == 0.1
    with pytest.raises(OctarmError, match="did you mean 100g"):
        octarm.load(disturbances=["payload:100"])


def test_a_missing_file_names_a_similar_one(tmp_path: Path):
    (tmp_path / "my-arm.toml").write_text("")
    with pytest.raises(OctarmError, match=r"my-amr.toml cannot be .*, did you mean 'my-arm.toml'"):
        read_arm(tmp_path / "my-amr.toml")
    with pytest.raises(OctarmError, match=r"No such file or directory$"):
        read_arm(tmp_path / "quite-another.toml")
    (tmp_path / "runs/first").mkdir(parents=True)
    (tmp_path / "runs/first/run.json").write_text("{}")
    with pytest.raises(OctarmError, match=r"it has no run.json, did you mean 'first'"):
        read_description(tmp_path / "runs/frist")


def test_differences_of_runs_have_units():
    arm = nominal_parameters()
    light, heavy = (
        {"parameters": a.to_dict(), "disturbances": [{"name": "payload", "asked": {"mass": m}}]}
        for a, m in ((arm, 0.1), (arm.scaled(mass=1.1), 0.2))
    )
    names = {each.name: each.values for each in differences([light, heavy])}
    assert "arm's mass [kg]" in names
    assert names["disturbance payload"] == ["mass [kg] 0.1", "mass [kg] 0.2"]


def test_the_ledger_has_the_units_that_a_users_disturbance_declares():
    entry = {"name": "gust-2", "asked": {"strength": 5.0, "at": 1.0}, "delivered": None}
    declares = {"strength": {"field": "strength", "unit": "N", "number": True}}
    code = {"gust": {"path": "gust.py:Gust", "declares": declares}}
    page = notes_of({"disturbances": [entry], "code": code})["ledger"]
    assert "| asked | strength [N] | 5 |" in page and "gust-2 5 N at 1 s" in page


def test_a_long_title_is_cut_at_words_that_the_notes_have():
    run = {
        "controller": {"name": "smc-boundary"},
        "reference": {"name": "sine", "amplitude": [0, 0, 0, 0.35, 0.25, 0], "frequency": 0.5},
        "disturbances": [{"name": "noise", "asked": {"ratio": 0.4}}] * 2,
    }
    assert short_title_of(run, 100).endswith("noise 40 %, noise 40 %")
    assert short_title_of(run, 50) == "smc-boundary on sine, noise 40 %, noise 40 %"
    assert short_title_of(run, 40) == "smc-boundary on sine, noise, noise"
    assert len(short_title_of(run, 20)) <= 20


def test_samples_that_end_before_the_run_are_said_so(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    t = np.linspace(0.0, 0.01, 21)
    np.savez("short.npz", t=t, theta1=0.01 * t)
    words = ["run", "--controller", "pd", "--reference", "file:short.npz", "--duration"]
    assert main([*words, "0.02", "--out", "a"]) == 0
    err = capsys.readouterr().err
    assert "short.npz end at 0.0105 s, and the run at 0.02 s: from then on" in err
    assert main([*words, "0.01", "--out", "b"]) == 0
    assert "end at" not in capsys.readouterr().err


def test_a_sweep_says_what_its_episodes_do_not_come_to(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    t = np.linspace(0.0, 0.01, 21)
    np.savez("short.npz", t=t, theta1=0.01 * t)
    Path("spec.toml").write_text(
        'duration = 0.02\nsettle = 0\nreference = "file:short.npz"\n[disturbance]\ntilt = "3deg"\n'
        'step.at = 5\n[grid.disturbance]\nstep = [0.0, 1.0]\npayload.at = [0.01, "30 s"]\n'
        'payload.mass = ["100 g"]\n[grid]\ncontroller = ["pd"]\n'
    )
    assert main(["sweep", "spec.toml", "--dry-run"]) == 0
    late, later, end = sorted(capsys.readouterr().err.splitlines())
    assert late == "octarm: payload begins at 30 s, and the run ends at 0.02 s before it"
    assert later == "octarm: step begins at 5 s, and the run ends at 0.02 s before it"
    assert "short.npz end at 0.0105 s, and the run at 0.02 s: from then on" in end


def test_a_margin_says_what_its_runs_do_not_come_to(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    t = np.linspace(0.0, 0.01, 21)
    np.savez("short.npz", t=t, theta1=0.01 * t)
    words = ["margin", "pd", "--duration", "0.02", "--settle", "0", "--seeds", "2", "--share", "1"]
    words += ["--disturbance", "payload:at=30", "--disturbance", "step:0.1,at=5"]
    words += ["--bound", "tip_rms_error:10mm", "--start", "moving", "--control-period", "1ms"]
    assert main([*words, "--reference", "file:short.npz", "--gains", "recommended"]) == 0
    out, err = capsys.readouterr()
    assert "octarm: payload begins at 30 s, and the run ends at 0.02 s before it\n" in err
    assert "octarm: step 0.1 begins at 5 s, and the run ends at 0.02 s before it\n" in err
    assert "short.npz end at 0.0105 s, and the run at 0.02 s: from then on" in err
    assert "--gains=recommended --reference=file:" in out
    assert "--settle=0.0 --control-period=0.001 --start=moving" in out


def test_samples_without_names_end_when_they_do_whatever_the_arm(tmp_path):
    file = tmp_path / "q.csv"
    file.write_text("".join(f"{0.1 * k},.12,.12,.12,0,0,0\n" for k in range(8)))
    assert samples_end(file) == pytest.approx(0.8)


def test_spaces_around_keys_do_not_matter():
    spelt = spelling(parse_disturbance("payload:100 g, at = 3 s"))
    assert spelt == spelling(parse_disturbance("payload:0.1,at=3"))


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["run", "--nominal", "mass:70"], "mass of --nominal is 70; it must be at most 20 unless "
         "it is spelt 7000%, did you mean 70%?"),
        (["arm", "--from-rod", "length=360,modules=3"], "length of 'length=360,modules=3' is "
         "360 m; it must be at most 10 m unless it is spelt 360m, did you mean 360mm?"),
        (["arm", "--from-rod", "length=36kg,modules=3"], "length of 'length=36kg,modules=3' is "
         "'36kg'; its unit must be m, cm, mm or um"),
        (["margin", "pd", "--disturbance", "payload", "--bound", "tip_rms_error:20"],
         "bound of tip_rms_error is 20 m; it must be at most 10 m unless it is spelt 20m, did you "
         "mean 20mm?"),
    ],
)  # fmt: skip
def test_a_bare_number_of_implausible_size_is_refused_wherever_it_stands(words, sentence, capsys):
    assert main(words) == 2
    assert capsys.readouterr().err == f"octarm: {sentence}\n"


def test_a_bound_with_its_unit_is_meant():
    assert parse_bound("tip_rms_error:20m") == ("tip_rms_error", 20.0)
    assert parse_bound("effort:200") == ("effort", 200.0)


def test_a_rod_may_be_given_in_units(capsys):
    words = ["arm", "--from-rod"]
    assert main([*words, "length=.36,EA=240:200,EI=.384,density=2,modules=3"]) == 0
    plain = capsys.readouterr().out
    assert main([*words, "length=36cm,EA=.24kN:200N,EI=.384Nm^2,density=2g/mm,modules=3"]) == 0
    assert capsys.readouterr().out == plain
