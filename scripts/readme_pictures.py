"""Makes the pictures of the README by the command line, and the moving picture that it opens with.

Pictures of the viewer need software Vulkan, films OpenGL, the report Chromium; `octarm doctor` says
what is missing. Those of the paper come from `scripts/reproduce_paper.py --publish`.
Run it: python scripts/readme_pictures.py [--only NAME ..] [--out .readme]
"""

import argparse
import functools
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import av
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
HARD = ("--mismatch", "-0.3", "--disturbance", "noise:40%", "--disturbance", "payload:100g,at=3",
        "--duration", "8")  # fmt: skip
ADAPTIVE = ("--controller", "afsmc", *HARD)
MOVING = (400, 400)  # size of the moving picture [pixel]
RATE = 12.5  # of the moving picture [Hz]
MOST = 3e6  # of its file [byte]


def octarm(*words: str | Path) -> None:
    """Runs a command; a run that diverges, code 3, is a run as well."""
    command = [sys.executable, "-m", "octarm", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    if done.returncode not in (0, 3):
        raise SystemExit(f"{' '.join(command)}\n{done.stderr}")


class Studio:
    """Makes pictures, and each run that they need once."""

    def __init__(self, scratch: Path, out: Path) -> None:
        """Pictures in `out`, runs in `scratch`."""
        self.scratch, self.out = scratch, out

    @functools.cache  # noqa: B019
    def run(self, *options: str) -> Path:
        """The folder of a run with these options."""
        folder = self.scratch / f"run-{len(list(self.scratch.iterdir()))}"
        octarm("run", *options, "--out", folder)
        return folder

    @functools.cache  # noqa: B019
    def sweep(self) -> Path:
        """A small sweep over noise with recorded episodes, and its report."""
        spec = self.scratch / "noise.toml"
        spec.write_text(
            'episodes = 8\nduration = 4.0\nreference = "sine"\n[grid]\n'
            'controller = ["pd", "smc", "smc-boundary", "afsmc"]\nmismatch = [-0.3, 0.0]\n'
            "[grid.disturbance]\nnoise = [0.0, 0.2, 0.4, 0.8]\n"
            '[record]\nepisodes = ["worst"]\n'
        )
        folder = self.scratch / "noise"
        octarm("sweep", spec, "--out", folder)
        octarm("report", folder)
        return folder

    def view(self, name: str, *runs: Path) -> None:
        """What the viewer shows of runs at its telling instant."""
        octarm("replay", *runs, "--screenshot", self.out / f"{name}.png", "--force")

    def film(self, run: Path, size: tuple[int, int], rate: float) -> list[Image.Image]:
        """The pictures of the film of a run."""
        file = self.scratch / "film.mp4"
        octarm("video", run, "--out", file, "--force", "--width", str(size[0]), "--height",
               str(size[1]), "--rate", str(rate))  # fmt: skip
        with av.open(str(file)) as container:
            return [frame.to_image() for frame in container.decode(video=0)]

    def figure(self, name: str, file: Path) -> None:
        """A figure that a command has written."""
        shutil.copyfile(file, self.out / f"{name}.png")


def moving(studio: Studio, name: str) -> None:
    """The arm under control, noise and a payload, as a GIF that repeats."""
    film = studio.film(studio.run(*ADAPTIVE), MOVING, RATE)
    pictures = film[int(2 * RATE) :]  # whole periods of the sine
    some = Image.new("RGB", (MOVING[0], 5 * MOVING[1]))
    for k in range(5):
        some.paste(pictures[k * (len(pictures) - 1) // 4], (0, k * MOVING[1]))
    palette = some.quantize(128)
    drawn = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    file = studio.out / "arm.gif"
    drawn[0].save(file, save_all=True, append_images=drawn[1:], duration=1000.0 / RATE, loop=0,
                  optimize=True)  # fmt: skip
    if file.stat().st_size > MOST:
        raise SystemExit(f"{file} has {file.stat().st_size} bytes; it must have at most {MOST:.0f}")


def plot(studio: Studio, name: str) -> None:
    """The figure of tracking."""
    octarm("plot", studio.run(*HARD), "--out", studio.scratch / "plot", "--force")
    studio.figure(name, studio.scratch / "plot" / "tracking.png")


def video(studio: Studio, name: str) -> None:
    """Three pictures of a film side by side."""
    pictures = studio.film(studio.run(*ADAPTIVE), (480, 480), 2.0)
    row = Image.new("RGB", (1440, 480))
    for k, at in enumerate((0.5, 5.5, 6.5)):
        row.paste(pictures[round(2.0 * at)], (480 * k, 0))
    row.save(studio.out / f"{name}.png")


def degradation(studio: Studio, name: str) -> None:
    """Errors over noise, from the report of a sweep."""
    studio.figure(name, studio.sweep() / "report" / "figures" / "degradation-noise.png")


def report(studio: Studio, name: str) -> None:
    """The top of the page of a sweep."""
    browser = next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
    if browser is None:
        raise SystemExit("the picture of the report needs Chromium")
    page, file = studio.sweep() / "report" / "report.html", studio.out / f"{name}.png"
    command = [browser, "--headless", "--no-sandbox", "--hide-scrollbars", "--disable-gpu",
               f"--user-data-dir={studio.scratch / 'browser'}", "--window-size=1280,1470",
               f"--screenshot={file.resolve()}", page.as_uri()]  # fmt: skip
    subprocess.run(command, capture_output=True, check=True)


def convergence(studio: Studio, name: str) -> None:
    """Errors of chains against the rod."""
    octarm("validate", "--rod", "--out", studio.scratch / "rod")
    studio.figure(name, studio.scratch / "rod" / "convergence.png")


def arm(studio: Studio, name: str) -> None:
    """What the numbers of an arm mean."""
    octarm("arm", "eth", "--out", studio.out / f"{name}.png", "--force")


PICTURES: dict[str, Callable[[Studio, str], None]] = {
    "run": lambda s, name: s.view(name, s.run("--mismatch", "-0.3")),
    "disturbed": lambda s, name: s.view(name, s.run(*HARD)),
    "compare": lambda s, name: s.view(name, s.run(*HARD), s.run(*ADAPTIVE)),
    "plot": plot,
    "video": video,
    "adaptive": lambda s, name: s.view(name, s.run(*ADAPTIVE)),
    "model_free": lambda s, name: s.view(name, s.run("--controller", "fuzzy")),
    "diverged": lambda s, name: s.view(name, s.run("--disturbance", "actuation-delay:60ms")),
    "episodes": lambda s, name: s.view(name, s.sweep()),
    "degradation": degradation,
    "report": report,
    "arm": arm,
    "convergence": convergence,
    "moving": moving,
}


def main() -> None:
    """Makes all pictures, or those that are named."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--only", nargs="+", choices=list(PICTURES), default=list(PICTURES))
    parser.add_argument("--out", type=Path, default=ROOT / ".readme", help="folder")
    arguments = parser.parse_args()
    arguments.out.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="octarm-") as scratch:
        studio = Studio(Path(scratch), arguments.out)
        for name in arguments.only:
            PICTURES[name](studio, name)
            print(f"made {name}", flush=True)


if __name__ == "__main__":
    main()
