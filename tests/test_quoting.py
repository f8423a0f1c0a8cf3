"""Names and values from outside: printable and short, wherever they are said or drawn."""

import contextlib
import http.client
import http.server
import importlib.util
import json
import resource
import socket
import subprocess
import sys
import threading
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recordings import described, swinging, write_run

import octarm
from controllers import make_controller
from octarm.commands import cli
from octarm.errors import FileError, OctarmError, closest, printable, quoted
from octarm.html import templates
from octarm.recordings import viewer
from octarm.recordings.words import notes_of, title_of

HOSTILE = "\x1b[31mred\x1b[0m\n\u202eevil\u2028\x85\x7f"


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@given(st.text(max_size=300), st.integers(12, 200))
def test_what_is_printable_stays_and_the_rest_is_escaped(text, longest):
    shown = printable(text)
    assert shown.isprintable()
    assert (shown == text) == text.isprintable()
    assert printable(shown) == shown
    assert "".join(c for c in text if c.isprintable()) in shown or not text.isprintable()
    short = printable(text, longest)
    assert short.isprintable() and len(short) <= longest
    assert short == shown or len(shown) > longest


@given(st.text() | st.integers() | st.floats() | st.lists(st.text()) | st.none() | st.binary())
def test_a_value_in_a_sentence_is_as_python_spells_it_and_short(value):
    text = quoted(value)
    assert text.isprintable() and len(text) <= 80
    if len(repr(value)) <= 80 and repr(value).isprintable() and "  " not in repr(value):
        assert text == repr(value)


def test_values_that_cannot_be_spelt_are_said_to_be_so():
    deep: list = []
    for _ in range(10**5):
        deep = [deep]
    assert "too long" in quoted(10**5000) and "too long" in quoted(deep)
    assert quoted(np.zeros(1000)).startswith("array([0., 0.")
    assert quoted("x" * 5000).startswith("'xxx") and "..." in quoted("x" * 5000)


def test_a_sentence_can_be_printed_whatever_is_in_it():
    for error in (OctarmError(f"{HOSTILE} is wrong"), FileError(f"{HOSTILE} is wrong")):
        assert str(error).isprintable()
        assert str(error).startswith(r"\x1b[31mred\x1b[0m\n\u202eevil\u2028\x85\x7f is wrong")
    assert len(str(OctarmError("x" * 10**6))) < 300
    assert len(str(OctarmError("x " * 10**6))) < 2500
    assert len(closest("x" * 10**6, ["a"])) < 100


SAID = [
    lambda word: octarm.load(word),
    lambda word: octarm.load(actuation=word),
    lambda word: make_controller(word, octarm.nominal_parameters()),
    lambda word: make_controller("pd", octarm.nominal_parameters(), {word: 1.0}),
    lambda word: octarm.nominal_parameters().scaled(**{word: 1.0}),
    lambda word: octarm.read_run(word),
    lambda word: octarm.read_spec(word),
]


@pytest.mark.parametrize("say", SAID)
@pytest.mark.parametrize("word", [HOSTILE, "x" * 5000, "a b " * 1500], ids=["escapes", "x", "ab"])
def test_no_sentence_has_a_value_raw_or_whole(say, word):
    with pytest.raises((OctarmError, FileError)) as caught:
        say(word)
    assert str(caught.value).isprintable() and len(str(caught.value)) <= 2000


def test_the_name_of_a_folder_is_escaped_where_it_is_printed(capsys):
    name = f"a{HOSTILE}"
    Path(name).mkdir()
    write_run(Path(name), swinging(rows=300), described(command=HOSTILE, message=HOSTILE))
    for words in (["plot", name, "--out", "figures"], ["record", name], ["verify", name]):
        cli.main(words)
        out, err = capsys.readouterr()
        assert all(line.isprintable() for line in (*out.split("\n"), *err.split("\n")))


def test_figures_titles_and_pages_of_text_have_no_name_raw():
    """The figures are drawn: a dollar sign begins no formula, XML has no control characters."""
    names = {"controller": {"name": f"$x_{{{HOSTILE}", "gains": {"$^": HOSTILE}}}
    description = (
        described() | names | dict(reference={"name": "日本" + "y" * 5000}, message=HOSTILE)
    )
    description |= {"status": "diverged", "command": HOSTILE * 1000}
    assert title_of(description).isprintable() and len(title_of(description)) <= 200
    for page in notes_of(description).values():
        assert all(line.isprintable() and len(line) < 3000 for line in page.split("\n"))
    Path("a").mkdir()
    write_run(Path("a"), swinging(rows=300), description)
    assert cli.main(["plot", "a", "--out", "figures"]) == 0
    for file in Path("figures").glob("*.svg"):
        ET.parse(file)
    assert cli.main(["record", "a"]) == 0


def test_a_page_has_no_value_raw():
    text = templates().from_string("<p>{{ a }}</p><pre>{{ b }}</pre>{{ 3 }}")
    page = text.render(a=HOSTILE.replace("\n", ""), b=f"one\n{HOSTILE}<")
    assert all(line.isprintable() for line in page.split("\n"))
    assert page.count("\n") == 2 and "&lt;" in page


class Viewer(http.server.BaseHTTPRequestHandler):
    """Stands where rerun serves its page."""

    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Length", "4")
        self.end_headers()
        self.wfile.write(b"page")

    def log_message(self, format, *args):
        pass


@pytest.fixture
def port():
    """That of the page which is passed on."""
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Viewer) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with viewer._guarded_page(server.server_address[1], 9) as page:
            yield page
        server.shutdown()


def answer(port, request):
    """The status that a request, as bytes, is answered with."""
    with socket.create_connection(("127.0.0.1", port), 5.0) as connection:
        connection.sendall(request)
        connection.shutdown(socket.SHUT_WR)
        head = connection.makefile("rb").readline()
    return int(head.split()[1])


def get(port, host, path=b"/"):
    return answer(port, b"GET " + path + b" HTTP/1.1\r\nHost: " + host + b"\r\n\r\n")


def test_the_page_answers_its_own_host_only(port, capfd):
    own = f"127.0.0.1:{port}".encode()
    for host in (own, f"localhost:{port}".encode(), f"LocalHost:{port}".encode()):
        assert get(port, host) == 200
    for host in (b"evil.example", b"127.0.0.1", b"localhost", f"evil.example:{port}".encode(),
                 b"127.0.0.1:1", f"127.0.0.1:{port}.evil.example".encode(), b"", b"[::1]:80",
                 f"0.0.0.0:{port}".encode(), b"\xff", b"127.0.0.1@evil"):  # fmt: skip
        assert get(port, host) == 403, host
    for path in (b"/\x7f", b"/\x01", b"/\xff", b"http://evil.example/", b"*", b"evil", b"/a b"):
        assert get(port, own, path) == 400, path
    twice = b"GET / HTTP/1.1\r\nHost: " + own + b"\r\nHost: evil.example\r\n\r\n"
    for request in (
        twice,
        b"GET / HTTP/1.1\r\n\r\n",
        b"GET / HTTP/9.9.9\r\n\r\n",
        b"\x00\xff\r\n\r\n",
    ):
        assert answer(port, request) in (400, 505), request
    post = b"POST / HTTP/1.1\r\nHost: " + own + b"\r\nContent-Length: 0\r\n\r\n"
    assert answer(port, post) == 501
    assert get(port, own) == 200
    assert capfd.readouterr() == ("", "")


def test_the_page_says_when_the_viewer_is_gone(capfd):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        nobody = probe.getsockname()[1]
    with viewer._guarded_page(nobody, 9) as port:
        assert get(port, f"127.0.0.1:{port}".encode()) == 502
        with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port)) as browser:
            browser.request("GET", "/")
            assert browser.getresponse().status == 502
    assert capfd.readouterr() == ("", "")


LIMITS = [3e8, 8e8, 1.5e9, 3e9]  # of addresses [byte]


@pytest.mark.slow
@pytest.mark.parametrize("limit", LIMITS)
@pytest.mark.parametrize("command", ["run --duration 0.01 --out new", "plot a", "record a"])
def test_too_little_memory_is_a_sentence(command, limit):
    Path("a").mkdir()
    write_run(Path("a"), swinging(rows=300), described())
    before = sorted(map(str, Path().rglob("*")))
    done = subprocess.run(
        [sys.executable, "-m", "octarm", *command.split()],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (int(limit), int(limit))),
        env={"PYTHONPATH": str(Path(octarm.__file__).parent.parent), "PATH": ""},
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode in (0, 2), done.stderr
    assert len(done.stderr.splitlines()) == (done.returncode == 2), done.stderr
    if done.returncode == 2:
        assert "memory" in done.stderr
        assert sorted(map(str, Path().rglob("*"))) == before


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        ImportError("libarrow.so: failed to map segment from shared object"),
        RuntimeError("can't start new thread"),
        OSError(12, "Cannot allocate memory"),
        pytest.param("mujoco", id="mujoco"),
    ],
)
def test_each_library_s_word_for_no_memory_is_understood(error, monkeypatch, capsys):
    if error == "mujoco":
        mujoco = importlib.import_module("mujoco")
        error = mujoco.FatalError("Could not allocate memory")

    def fail():
        raise error

    monkeypatch.setattr("octarm.commands.app.parse", lambda _: fail)
    assert cli.main(["run"]) == 2
    assert capsys.readouterr().err.startswith("octarm: there is not enough memory")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device without end, as on Linux")
def test_a_file_without_end_is_a_sentence(capsys):
    assert cli.main(["sweep", "/dev/full", "--dry-run"]) == 2
    assert "/dev/full has more than" in capsys.readouterr().err


DAMAGE = {
    "401 digits": (("duration",), 10**400, "is too large a number"),
    "host": (("host",), "x", 'host is "x"; it must be'),
    "status": (("status",), None, "status is null; it must be"),
    "status of another kind": (("status",), "fine", 'status is "fine"; it must be'),
    "gains": (("controller", "gains"), [], "gains is []; it must be a table"),
    "parameters": (("parameters", "mass"), [], "mass has shape"),
    "name": (("reference", "name"), HOSTILE, "custom reference"),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_description_is_a_sentence(damage, capsys):
    keys, value, sentence = DAMAGE[damage]
    assert cli.main("run --duration 0.01 --out a".split()) == 0
    description = json.loads(Path("a/run.json").read_text())
    table = description
    for key in keys[:-1]:
        table = table[key]
    table[keys[-1]] = value
    Path("a/run.json").write_text(json.dumps(description))
    capsys.readouterr()
    assert cli.main(["verify", "a"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert sentence in line and len(line) < 500
    if "name" not in keys:
        assert cli.main(["record", "a"]) == 2
    del table[keys[-1]]
    Path("a/run.json").write_text(json.dumps(description))
    again = "plot" if damage in ("gains", "parameters") else "record"  # drawing takes longer
    assert cli.main([again, "a"]) in (0, 2)
    assert len(capsys.readouterr().err.splitlines()) <= 2


@pytest.mark.parametrize(
    "array",
    [
        1.0,
        np.ones(1, np.float32),
        np.array(["x"]),
        np.array([1j]),
        np.ones(2, ">f8"),
        np.array([None]),
    ],
    ids=["number", "single", "word", "complex", "big-endian", "object"],
)
@pytest.mark.parametrize("name", ["q", "t", "layer", "status", "s", "new"])
def test_only_what_is_written_is_read(array, name, capsys):
    Path("a").mkdir()
    write_run(Path("a"), swinging(rows=300), described())
    arrays = dict(np.load("a/run.npz"))
    np.savez("a/run.npz", **{**arrays, name: array})
    for command in ("plot", "record"):
        assert cli.main([command, "a"]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "run.npz is not a trajectory file (" in line
    with pytest.raises(OctarmError, match="is not a trajectory file"):
        octarm.read_run("a")
    assert sorted(map(str, Path().iterdir())) == ["a"]


NUMBERS = [np.nan, np.inf, -1e308, 5e-324]


@pytest.mark.parametrize(
    "turn", [0, 1, *(pytest.param(turn, marks=pytest.mark.slow) for turn in (2, 3))]
)
def test_any_numbers_can_be_drawn_and_recorded(turn):
    """Those of the motion are others than those of forces."""
    Path("a").mkdir()
    write_run(Path("a"), swinging(rows=60), described())
    arrays = dict(np.load("a/run.npz"))
    for i, names in enumerate([("q", "q_d"), ("tau", "s", "V", "disturbance")]):
        for name in names:
            arrays[name][::2] = NUMBERS[(turn + i) % 4]
    np.savez("a/run.npz", **arrays)
    assert cli.main(["plot", "a", "--out", "figures"]) == 0
    assert cli.main(["record", "a"]) == 0
