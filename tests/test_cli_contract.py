"""What users of the command line rely on: spellings, defaults, exit codes, errors, help pages."""

import contextlib
import io
import re
import subprocess
import sys
from pathlib import Path

import pytest

from controllers import CONTROLLERS
from octarm.arm.actuation import ACTUATIONS
from octarm.commands.cli import main
from octarm.disturbances.spelling import DISTURBANCES
from octarm.references import REFERENCES

GROUPS = {
    "one run": ["run", "view", "replay", "record", "plot", "video", "compare"],
    "many runs": ["sweep", "report", "margin", "tune"],
    "an arm": ["arm"],
    "your own": ["new"],
    "checks": ["validate", "verify"],
    "this machine": ["doctor", "completion"],
}
COMMANDS = [name for names in GROUPS.values() for name in names]

# Of each command its operands and its options by heading: the kind of value (empty for a flag),
# and the default where the help names one; `..` where it may be given several times.
OPERANDS = {
    "replay": "RUN ..", "compare": "RUN ..",
    "record": "RUN", "plot": "RUN", "video": "RUN", "sweep": "SPEC.toml",
    "report": "SWEEP", "margin": "CONTROLLER ..", "tune": "CONTROLLER", "verify": "RUN ..",
    "completion": "SHELL", "arm": "ARM ..", "new": "KIND NAME",
}  # fmt: skip
SHARED = {
    "the arm, and the model that the controller believes": {
        "--arm": "ARM",
        "--mismatch": "X 0",
        "--nominal": "NAME:FACTOR ..",
        "--model": "ARM",
        "--parameter": "NAME:VALUES ..",
        "--plant-modules": "N",
        "--layout": "LAYOUT paper",
        "--sensing": "SENSING groups",
    },
    "gains": {"--gains": "GAINS", "--gain": "NAME:VALUES ..", "--roll-off": "HZ"},
}
SHARED_MODEL = SHARED["the arm, and the model that the controller believes"]
OPTIONS: dict[str, dict[str, dict[str, str]]] = {
    "arm": {
        "another source of the arm": {
            "--from-rod": "KEY=VALUE,..",
            "--fit-modules": "N",
            "--layout": "LAYOUT paper",
        },
        "output": {"--write": "FILE.toml", "--out": "FILE.png", "--force": ""},
        "stability of the sampled loop": {
            "--controller": "CONTROLLER ..",
            "--gains": "GAINS",
            "--roll-off": "HZ",
            "--control-period": "S",
            "--plant-modules": "N",
            "--model": "ARM",
        },
    },
    "run": {
        "the experiment": {
            "--controller": "CONTROLLER smc-boundary",
            "--reference": "REFERENCE sine",
            "--disturbance": "DISTURBANCE ..",
            "--metric": "METRIC ..",
            "--duration": "S 10",
            "--settle": "S 2",
            "--seed": "N 0",
            "--start": "START rest",
            "--start-share": "X 0.1",
        },
        **SHARED,
        "simulation": {
            "--timestep": "S",
            "--control-period": "S",
            "--actuation": "ACTUATION f-coeff",
            "--integrator": "INTEGRATOR rk4",
            "--engine": "ENGINE mujoco",
        },
        "output": {"--out": "DIR", "--force": "", "--view": "", "--live": "[HOST:PORT]"},
    },
    "view": {
        "the experiment": {
            "--controller": "CONTROLLER smc-boundary",
            "--reference": "REFERENCE sine",
            "--disturbance": "DISTURBANCE ..",
            "--seed": "N 0",
            "--start": "START rest",
            "--start-share": "X 0.1",
        },
        "the arm, and the model that the controller believes": {
            "--arm": "ARM",
            "--mismatch": "X 0",
        },
        "gains": {"--gains": "GAINS", "--gain": "NAME:VALUES ..", "--roll-off": "HZ"},
        "simulation": {"--control-period": "S"},
    },
    "compare": {"options": {"--out": "DIR", "--force": ""}},
    "replay": {"options": {"--screenshot": "FILE.png", "--time": "S", "--web": "", "--force": ""}},
    "record": {"options": {"--out": "FILE.rrd", "--force": ""}},
    "plot": {"options": {"--out": "DIR", "--force": ""}},
    "video": {
        "options": {
            "--out": "FILE.mp4",
            "--width": "N 960",
            "--height": "N 720",
            "--rate": "HZ 30",
            "--speed": "X 1",
            "--force": "",
        }
    },
    "sweep": {
        "options": {
            "--out": "DIR",
            "--workers": "N",
            "--resume": "",
            "--force": "",
            "--dry-run": "",
            "--cluster": "ADDRESS",
            "--wait-for-workers": "S 60",
            "--engine": "ENGINE",
        }
    },
    "report": {
        "options": {
            "--baseline": "CONTROLLER",
            "--metric": "METRIC ..",
            "--columns": "",
            "--run-code": "",
            "--out": "DIR",
            "--force": "",
        },
    },
    "margin": {
        "what is sought": {
            "--disturbance": "DISTURBANCE ..",
            "--bound": "METRIC:VALUE ..",
            "--low": "X",
            "--high": "X",
            "--seeds": "N 36",
            "--share": "X 0.9",
            "--metric": "METRIC ..",
        },
        **SHARED,
        "the arm, and the model that the controller believes": {**SHARED_MODEL, "--arm": "ARM .."},
        "the runs, as in octarm run": {
            "--reference": "REFERENCE sine",
            "--duration": "S 6",
            "--settle": "S 2",
            "--timestep": "S",
            "--control-period": "S",
            "--seed": "N 0",
            "--start": "START rest",
            "--start-share": "X 0.1",
            "--engine": "ENGINE",
        },
        "output": {"--csv": "FILE", "--json": "FILE", "--force": ""},
    },
    "tune": {
        "the experiment": {"--reference": "REFERENCE", "--disturbance": "DISTURBANCE .."},
        **SHARED,
        "options": {
            "--out": "FILE.toml",
            "--budget": "S 16000",
            "--seed": "N 0",
            "--resume": "",
            "--force": "",
            "--engine": "ENGINE",
            "--workers": "N",
        },
    },
    "validate": {
        "options": {
            "--controllers": "",
            "--engines": "",
            "--plant-modules": "N",
            "--layout": "LAYOUT paper",
            "--arm": "ARM",
            "--rod": "",
            "--modules": "N 3",
            "--random-parameters": "N 0",
            "--states": "N",
            "--seed": "N 0",
            "--json": "FILE",
            "--out": "DIR",
            "--force": "",
        }
    },
    "verify": {"options": {"--episode": "N ..", "--sample": "N"}},
    "new": {},
    "doctor": {},
    "completion": {},
}


def options_of(command: str) -> list[tuple[str, ...]]:
    """Options of a command: the flag, its kind of value, and its default."""
    headings = OPTIONS[command].values()
    return [(flag, *kind.partition(" ")[::2]) for each in headings for flag, kind in each.items()]


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)


def page(*words: str) -> str:
    """What `octarm WORDS` prints, where all is well."""
    out = io.StringIO()
    code: object = 0
    with contextlib.redirect_stdout(out):
        try:
            code = main(words)
        except SystemExit as leaving:
            code = leaving.code
    assert not code
    return out.getvalue()


def refused(*words: str) -> str:
    """The sentence that `octarm WORDS` is refused with."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        assert main(words) == 2
    assert out.getvalue() == ""
    (line,) = err.getvalue().splitlines()
    assert line.startswith("octarm: ")
    assert list(Path().iterdir()) == []
    return line.removeprefix("octarm: ")


def sections(text: str) -> dict[str, str]:
    """The parts of a help page by heading."""
    parts = re.split(r"^(\w.*):$\n", text, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def entry(text: str, flag: str) -> str:
    """What a help page says of an option, on one line."""
    found = re.search(rf"^  {re.escape(flag)}(?![\w-]).*\n(?:    .*\n)*", text, re.MULTILINE)
    assert found is not None, flag
    return " ".join(found[0].split())


def test_the_overview_has_the_commands_by_group_and_the_exit_codes():
    text = page("--help")
    assert page("-h") == text
    parts = sections(text)
    for title, names in GROUPS.items():
        assert re.findall(r"^  (\w+)  +\w.*\.$", parts[title], re.MULTILINE) == names
    assert "0 fine, 1 a check failed, 2 bad input, 3 the run diverged, 130 interrupted" in text
    assert "--version" in text
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize("command", COMMANDS)
def test_a_help_page_has_operands_and_options_by_heading(command: str):
    text = page(command, "--help")
    assert page(command, "-h") == text
    assert max(map(len, text.splitlines())) <= 80
    assert text.startswith(f"usage: octarm {command}")
    parts = sections(text)
    operand, *others = OPERANDS.get(command, "").split() or [""]
    several = others == [".."]
    usage = text.splitlines()[0]
    assert (f"{operand} [{operand} ..]" if several else f" {operand}") in usage
    if operand:
        assert entry(parts["operands"], operand)
    for heading, options in OPTIONS[command].items():
        flags = re.findall(r"^  (--[\w-]+)", parts[heading], re.MULTILINE)
        assert flags == list(options)
    known = [flag for options in OPTIONS[command].values() for flag in options]
    before_examples = text.partition("\nexamples:\n")[0]
    assert re.findall(r"^  (--[\w-]+)", before_examples, re.MULTILINE) == known
    assert re.search(rf"^  octarm {command}", parts["examples"], re.MULTILINE)


@pytest.mark.parametrize("command", OPTIONS)
def test_an_option_has_its_kind_of_value_and_its_default(command: str):
    whole = page(command, "--help")
    for flag, kind, default in options_of(command):
        text = entry(whole, flag)
        assert text.startswith(f"{flag} {kind}".strip() + " ")
        assert ("(repeatable)" in text) == (default == "..")
        shown = re.search(r"\(default: (.*)\)", text)
        assert (shown[1] if shown else "") == (default if default != ".." else "")


@pytest.mark.parametrize("command", OPTIONS)
def test_an_option_takes_one_value_and_a_flag_none(command: str):
    words = [command, "x"] if command in OPERANDS else [command]
    for flag, kind, default in options_of(command):
        if kind.startswith("["):  # its value may be left out
            assert flag in refused(*words, flag, "1", "2")
        elif kind:
            assert refused(*words, flag) == f"{flag} needs a value after it"
            if default != "..":
                again = refused(*words, flag, "1", f"{flag}=2")
                assert again.startswith(f"{flag} is given twice")
        else:
            assert flag in refused(*words, f"{flag}=perhaps")
            no = flag.replace("--", "--no-")
            assert no in refused(*words, no)
        if kind in ("S", "X", "N", "HZ"):
            wrong = "1.5" if kind == "N" else "some"
            needed = "a whole number" if kind == "N" else "a number"
            if flag == "--timestep":  # a physics step may be left to the arm
                needed = "a number [s] or auto"
            assert refused(*words, flag, wrong) == f"{flag} is {wrong!r}; it must be {needed}"


@pytest.mark.parametrize("word", ["some", "1.5.1", "1e", "0x10", "--nowhere"])
def test_what_is_no_number(word: str):
    for flag, needed in (("--seed", "a whole number"), ("--duration", "a number")):
        if (flag, word) != ("--duration", "0x10"):
            told = refused("run", flag, word)
            assert told == f"{flag} is {word!r}; it must be {needed}" or word == "--nowhere"
            assert flag in told


@pytest.mark.parametrize("command", OPERANDS)
def test_operands_are_needed_and_counted(command: str):
    kind, *others = OPERANDS[command].split()
    if command == "arm":  # the nominal one when none is given
        return
    if others != [".."]:
        assert refused(command).startswith(f"octarm {command} needs {kind}, ")
        assert "'y'" in refused(command, "x", *others, "y")
    else:
        assert re.search(r"RUN|run|CONTROLLER|controller", refused(command))


def test_words_that_are_not_known_are_refused_with_the_closest():
    near = f"the nearest of {len(COMMANDS)} are "
    assert refused("ran").startswith(f"unknown command 'ran', did you mean 'run'? {near}run, ")
    assert refused("xyz").startswith(f"unknown command 'xyz'; {near}")
    assert refused() == "no command is given; octarm --help lists them"
    assert refused("run", "--duraton", "3").startswith(
        "octarm run has no option '--duraton', did you mean '--duration'? the nearest of "
    )
    assert refused("run", "--duraton=3").startswith("octarm run has no option '--duraton', did")
    assert refused("run", "--dur", "3").startswith("octarm run has no option '--dur'")
    assert (
        refused("run", "--states", "1")
        == "octarm run has no option --states; it belongs to octarm validate"
    )
    assert refused("run", "twice") == "octarm run has no use for 'twice'"
    assert "'-x'" in refused("run", "-x")
    assert refused("run", "--controller", "smc-boundry").startswith(
        "unknown controller 'smc-boundry', did you mean 'smc-boundary'? known are pd, "
    )
    assert refused("run", "--reference", "cosine").startswith("unknown reference 'cosine'")
    assert refused("run", "--reference", "sine:amplitud=1").startswith(
        "sine has no key 'amplitud', did you mean 'amplitude'? known are amplitude, frequency"
    )
    assert refused("run", "--reference", "sine:amplitude=1m") == (
        "amplitude of 'sine:amplitude=1m' is '1m'; its unit must be rad, mrad or deg"
    )
    assert refused(
        "margin",
        "pd",
        "--disturbance",
        "noise",
        "--bound",
        "tip_rms_error:1",
        "--reference",
        "tip:size=9m",
    ).startswith("the tip cannot follow the circle")
    assert refused("run", "--actuation", "extern").startswith("unknown actuation 'extern'")
    assert refused("run", "--disturbance", "nois:1").startswith("unknown disturbance 'nois'")
    assert refused("run", "--nominal", "mas:1").startswith("unknown parameter 'mas'")
    assert refused("run", "--parameter", "wdith:1").startswith("unknown parameter 'wdith'")
    assert refused("run", "--gain", "Q:1").startswith("smc-boundary has no gain 'Q'")
    assert refused("completion", "tcsh") == "unknown shell 'tcsh'; known are bash, zsh, fish"


SPELLINGS = [
    ["--mismatch", "-0.3"],
    ["--mismatch=-0.3"],
    ["--mismatch", "-.3"],
    ["--mismatch", "-3e-1"],
]


def test_values_may_be_negative_and_stand_after_a_space_or_an_equals_sign():
    described = []
    for i, words in enumerate(SPELLINGS):
        assert main(["run", *words, "--duration", "0.005", "--out", f"r{i}"]) == 0
        described.append(re.sub(r'"command": .*', "", Path(f"r{i}/run.json").read_text()))
    assert len(set(described)) == 1


def test_repeatable_options_keep_their_order_and_operands_may_stand_anywhere(
    capsys: pytest.CaptureFixture[str],
):
    words = "--disturbance noise:0.4 --gain lambda:15 --disturbance=payload:0.1,at=0.001 --gain=K:2"
    assert main(["run", *words.split(), "--duration", "0.005", "--out", "=-odd"]) == 0
    text = Path("=-odd/run.json").read_text()
    assert text.index('"noise"') < text.index('"payload"')
    assert main(["record", "--out", "again.rrd", "=-odd"]) == 0
    assert Path("again.rrd").exists()
    capsys.readouterr()
    words = "pd --low -1e-3 --disturbance nominal-mismatch smcc --bound tip_rms_error:1 --seeds=1"
    assert main(["margin", *words.split()]) == 2
    assert "unknown controller 'smcc'" in capsys.readouterr().err


def test_the_names_to_choose_from_stand_in_the_help():
    text = page("run", "--help")
    words = " ".join(text.split())
    for name in [*CONTROLLERS, *REFERENCES, *ACTUATIONS]:
        assert re.search(rf"(?<![\w-]){name}(?![\w-])", words), name
    listed = text.partition("\nexamples:\n")[2]
    for name in REFERENCES:
        assert re.search(rf"^  {name}:\w", listed, re.MULTILINE), name
    for name in DISTURBANCES:
        assert re.search(rf"^  (?:.*  )?{name}:", listed, re.MULTILINE), name
    for command in ("margin", "tune"):
        operand = entry(page(command, "--help"), "CONTROLLER")
        assert [name for name in CONTROLLERS if name not in operand] == []
    shells = entry(page("completion", "--help"), "SHELL")
    assert all(shell in shells for shell in ("bash", "zsh", "fish"))


def imported(*lines: list[str]) -> set[str]:
    """The heavy packages that are imported while lines of words are understood or refused."""
    code = (
        "import sys\n"
        "from octarm.commands.cli import main\n"
        f"for words in {lines!r}:\n"
        "    try: main(words)\n"
        "    except SystemExit: pass\n"
        "heavy = {'numpy', 'scipy', 'mujoco', 'dm_control', 'rerun', 'matplotlib', 'pyarrow',\n"
        "         'numba'}\n"
        "print(*heavy & set(sys.modules), file=sys.stderr)"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return set(done.stderr.splitlines()[-1].split())


def test_nothing_heavy_is_imported_before_the_words_are_understood():
    lines = ["--help", "--version", "plot --help", "ran", "run --duraton 3", "run --duration long"]
    assert imported(*(line.split() for line in [*lines, "margin --low", "record"])) == set()


BAD_INPUT = [
    "run --controller SMC",
    "run --controller ./nowhere.py:Law",
    "run --reference SINE",
    "run --disturbance nose:1",
    "run --metric nothing",
    "run --arm eht",
    "run --engine lagrang",
    "run --layout central",
    "run --sensing plate",
    "run --parameter wdith:1",
    "run --nominal mas:1",
    "run --gains tuend",
    "run --gain lambda",
    "run --gain lamda:3",
    "run --timestep 0.3",
    "run --timestep=-1",
    "run --start rset",
    "run --start random --start-share 0",
    "run --duration -1",
    "run --settle=-1",
    "margin SMC --disturbance payload --bound tip_rms_error:1mm",
    "margin smc --disturbance paylaod --bound tip_rms_error:1mm",
    "margin smc pd --gain phi:1 --disturbance payload --bound tip_rms_error:1mm",
    "tune SMC",
    "tune pd --gain lambda:3",
    "sweep nowhere.toml",
    "report runs/x",
    "replay runs",
    "plot runs/x",
    "video runs/x",
    "verify runs/x",
    "validate --arm eht",
    "run --disturbance noise:abc",
    "run --disturbance tilt:200deg",
    "run --disturbance payload:100",
    "run --reference sine:amplitude=7",
    "run --reference file:nowhere.csv",
    "view --disturbance payload:100",
    "margin smc --bound nope",
    "margin smc --disturbance payload --bound nope:1",
    "margin smc --disturbance payload:1 --bound tip_rms_error:1mm",
    "margin smc --disturbance payload --high 100 --bound tip_rms_error:1mm",
    "margin smc",
    "tune smc --budget 200",
    "tune smc --disturbance lag:60",
    "compare nope",
    "compare nope nope",
]


def test_bad_input_is_answered_without_the_simulation():
    assert imported(*(line.split() for line in BAD_INPUT)) <= {"numpy"}


def test_the_help_of_a_command_does_not_wait_for_the_simulation():
    assert imported(*([command, "--help"] for command in COMMANDS)) <= {"numpy"}
