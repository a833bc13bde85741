"""Films of the servo on test patients: three who were found and one failure, with its reason.

python -m tests.envs.studies.films      # writes docs/images/servo-*.gif and docs/results/films.json

Which episodes are shown is a rule on the published figures of each episode (the evidence of the
board `beating`), not a choice: of the first training and the first start of each patient, ordered
by the distance to the patient's own pose at the end, those at a quarter, half and three quarters of
the found, and the one in the middle of the others. They are run again; a film is drawn only if it
ends as the published one did, to `SAME` of its distance.
"""

import io
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl
import torch
from PIL import Image, ImageDraw
from torch import Tensor

from racines_data.files import write_atomic, write_json
from racines_data.geometry import Pose
from racines_data.patients.labels import LABELS
from racines_data.patients.landmarks import landmarks
from racines_data.plotting import letters, mark_depth
from racines_data.randomness import derive
from racines_envs.demo.watching import Shot, Watched, watch
from racines_envs.evaluation.patients import PatientsConfig, StartSet
from racines_envs.evaluation.run import core_for
from racines_envs.task.core import ScanCore
from racines_envs.worlds.ward import Ward, make_ward

ROOT = Path(__file__).parents[3]
POLICY, BOARD = ROOT / "envs/weights/servo", "beating"
EVIDENCE = ROOT / f"leaderboard/results/{BOARD}/patient-agents/servo-a4c"
IMAGES, RESULT = ROOT / "docs/images", ROOT / "docs/results/films.json"
QUARTERS = (0.25, 0.5, 0.75)
SAME = 1e-3
"""Millimetres by which a film may end elsewhere than the published episode."""
SIDE, WIDTH, HEIGHT, SHADES = 208, 432, 208, 24
EVERY, HELD = 2, 30
"""Steps from picture to picture, and pictures' worth of time that the last one stands."""
MILLISECONDS = 160
SEEN = {"apex": "LV apex", "lv": "LV", "septum": "septum", "la": "LA", "ra": "RA"}
"""Landmarks that a failure is told by, and their names."""
BACK, INK, FAINT, TRUE, READ = 12, 235, 110, 255, 150
FONT, SMALL = letters(12), letters(11)


class Episode(NamedTuple):
    """One to be shown."""

    title: str
    patient: int
    start: int
    distance: float
    """Millimetres to the patient's own pose at the end, as published; NaN where nobody looked."""


def chosen() -> list[Episode]:
    """Return the episodes that the rule names."""
    scores = json.loads(EVIDENCE.with_suffix(".json").read_text())["scores"]
    starts = scores["task"]["start_set"]["starts"]
    table = pl.read_parquet(EVIDENCE.with_suffix(".parquet")).filter(pl.col("training") == 0)

    def figures(metric: str) -> np.ndarray:
        return table.filter(pl.col("metric") == metric).sort("item")["value"].to_numpy()

    patients = table.filter(pl.col("metric") == "success_declared").sort("item")["unit"].to_numpy()
    found, distance = figures("success_declared") > 0, figures("position_error_median")
    first = np.arange(len(found)) % starts == 0

    def at(wanted: np.ndarray, share: float) -> int:
        ordered = np.flatnonzero(wanted)[np.argsort(distance[wanted], kind="stable")]
        return int(ordered[round(share * (len(ordered) - 1))])

    places = [(f"found-{i + 1}", at(first & found, share)) for i, share in enumerate(QUARTERS)]
    places.append(("failure", at(first & ~found, 0.5)))
    return [Episode(title, int(patients[i]), 0, float(distance[i])) for title, i in places]


@torch.no_grad()
def run(episodes: list[Episode], split: str) -> tuple[ScanCore, list[list[Shot]]]:
    """Let the first training act; return the environment at the end, and each row's pictures."""
    config = PatientsConfig(view=f"A4C-{BOARD}", split=split, starts=1)
    agent = Watched.load(POLICY)
    ward = make_ward(BOARD, split, tuple(each.patient for each in episodes))
    seeds = torch.cat(
        [StartSet((each.patient,), each.start + 1, 0).seeds[-1:] for each in episodes]
    )
    case = ward.case_of([each.patient for each in episodes])
    core = core_for(agent, config.task, len(seeds), reward="oracle", phantom=ward)
    return core, watch(core, agent, seeds, case)


def film(episode: Episode, shots: list[Shot], own: np.ndarray, found: bool, mm: float) -> bytes:
    """Return a GIF: every other step, then the end beside the patient's own view.

    `mm` is the side of an image's pixel.
    """
    steps = [shot for shot in shots if shot.step % EVERY == 0 or shot.ended]
    frames = [frame(episode, shots, shot, mm) for shot in steps]
    frames.append(ending(episode, shots[-1], own, found, mm))
    gray = [Image.fromarray(_few(np.asarray(each))) for each in frames]
    times = [MILLISECONDS] * (len(gray) - 1) + [MILLISECONDS * HELD]
    buffer = io.BytesIO()
    gray[0].save(buffer, "GIF", save_all=True, append_images=gray[1:], duration=times, loop=0,
                 optimize=True)  # fmt: skip
    return buffer.getvalue()


def _few(picture: np.ndarray) -> np.ndarray:
    """Return a picture in few shades of gray, which a GIF packs well."""
    width = 255.0 / (SHADES - 1)
    return (np.round(picture / width) * width).astype(np.uint8)


def _marked(image: np.ndarray, side: int, mm: float) -> Image.Image:
    picture = Image.fromarray(image).resize((side, side), Image.Resampling.BICUBIC)
    mark_depth(picture, mm * len(image) / side)
    return picture


def _sheet(image: np.ndarray, mm: float) -> tuple[Image.Image, ImageDraw.ImageDraw]:
    sheet = Image.new("L", (WIDTH, HEIGHT), BACK)
    sheet.paste(_marked(image, SIDE, mm), (0, 0))
    return sheet, ImageDraw.Draw(sheet)


def _write(draw: ImageDraw.ImageDraw, lines: list[str], top: int, left: int = SIDE + 12) -> None:
    for number, line in enumerate(lines):
        draw.text((left, top + 19 * number), line, INK, FONT)


def frame(episode: Episode, shots: list[Shot], shot: Shot, mm: float) -> Image.Image:
    """Return one picture: the image, what is true and believed in words, and both grades so far."""
    sheet, draw = _sheet(shot.image, mm)
    lines = [
        f"{episode.title}: patient {episode.patient}",
        f"step {shot.step} of {shots[-1].step}, {0.1 * shot.step:.1f} s",
        f"to the view: {shot.distance:.0f} mm",
        f"believed: {shot.believed:.0f} mm",
        f"grade: {shot.grade:.1f}, read: {shot.read:.1f}",
    ]
    _write(draw, lines, 6)
    left, right, top, bottom = SIDE + 14, WIDTH - 10, 122, HEIGHT - 6
    draw.rectangle((left, top, right, bottom), outline=FAINT)
    middle = bottom - (bottom - top) * 0.5
    draw.line((left, middle, right, middle), fill=FAINT)
    draw.text((left + 3, middle - 14), "5", FAINT, SMALL)
    for key, ink, width in (("read", READ, 1), ("grade", TRUE, 2)):
        points = [
            (left + (right - left) * each.step / shots[-1].step,
             bottom - (bottom - top) * min(max(getattr(each, key), 0.0), 10.0) / 10.0)
            for each in shots
            if each.step <= shot.step
        ]  # fmt: skip
        if len(points) > 1:
            draw.line(points, fill=ink, width=width)
    draw.text((left, top - 14), "grade: thick true, thin read", FAINT, SMALL)
    return sheet


def ending(episode: Episode, shot: Shot, own: np.ndarray, found: bool, mm: float) -> Image.Image:
    """Return the last picture: the image that was declared beside the patient's own view."""
    sheet, draw = _sheet(shot.image, mm)
    side = WIDTH - SIDE - 16
    sheet.paste(_marked(own, side, mm), (SIDE + 16, 0))
    _write(draw, ["declared:", "found" if found else "wrong"], 4, 6)
    _write(draw, ["the patient's", "own A4C"], 4, SIDE + 22)
    told = f"{shot.distance:.0f} mm apart, grade {shot.grade:.1f}, read {shot.read:.1f}"
    draw.text((6, SIDE - 18), told, INK, SMALL)
    return sheet


def reason(core: ScanCore, row: int) -> dict[str, Any]:
    """Return what the last pose of a row shows and what the patient's own pose does, in numbers.

    `here` and `own`: how far landmarks are seen, per cent, over a beat, and the length of the
    ventricle in the plane, mm. `apart`: from pose to pose; `across`: of that across the ribs, along
    the skin, whose `spacing` stands beside; mm.
    """
    one = torch.tensor([row])
    ward = core.phantom
    assert isinstance(ward, Ward)
    pool, case = ward.pool, core.state.case[one]
    scene = ward.scene(case, torch.zeros(1, dtype=torch.float64))
    here = Pose(core.state.position[one], core.state.rotation[one])
    own = scene.target("A4C")
    heart = pool.hearts[int(case)]
    names = [mark.name for mark in landmarks(heart.shape)]
    shown = {}
    for title, pose in (("here", here), ("own", own)):
        truth = scene.judge(pose)
        seen = dict(zip(names, truth.visibility[0].tolist(), strict=True))
        shown[title] = {key: round(100 * seen[name]) for key, name in SEEN.items()}
        shown[title]["length"] = round(ventricle(pool, pose, case))
    apart = 1e3 * (here.position - own.position)[0, :2].double()
    across = heart.chest.across[0]
    return shown | {
        "apart": round(1e3 * float((here.position - own.position)[0].norm()), 1),
        "across": round(float((apart * across).sum().abs()), 1),
        "spacing": round(1e3 * heart.patient.chest.rib_spacing, 1),
    }


def ventricle(pool: Any, pose: Pose, case: Tensor) -> float:
    """Return the length of the left ventricle in the plane at end diastole, mm; 0: not there.

    Along its main axis, from the second to the ninety-eighth hundredth of its pixels.
    """
    mask = pool.mask(pose, case, torch.zeros(1, 2, dtype=torch.float64))[0]
    places = (mask == LABELS.index("LV")).nonzero().double()
    if len(places) < 20:
        return 0.0
    centred = places - places.mean(0)
    _, vectors = torch.linalg.eigh(centred.T @ centred)
    along = centred @ vectors[:, -1]
    ends = torch.quantile(along, torch.tensor([0.02, 0.98], dtype=torch.float64))
    return float((ends[1] - ends[0]) * pool.pixel_size(case)[0])


def own_views(core: ScanCore) -> np.ndarray:
    """Return (N, 128, 128) pictures of the patients' own view at the moment of the end."""
    scene = core.scene()
    seeds = derive(core.state.seed, core.state.steps)
    return scene.render(scene.target("A4C"), seeds).cpu().numpy()


def make(episodes: list[Episode], split: str, images: Path) -> dict[str, Any]:
    """Draw the films into a folder; return what is to be told of them.

    Raises:
        ValueError: an episode ends elsewhere than the published one.
    """
    core, shots = run(episodes, split)
    info, own = core.info(view_error=False), own_views(core)
    ward = core.phantom
    assert isinstance(ward, Ward)
    sides = ward.pool.pixel_size(core.state.case).tolist()
    rows, told = [], {}
    for row, (episode, each) in enumerate(zip(episodes, shots, strict=True)):
        last, found = each[-1], bool((info["success"] & info["declared"].bool())[row])
        if abs(last.distance - episode.distance) > SAME:
            raise ValueError(f"{episode}: ends {last.distance} mm away")
        write_atomic(
            images / f"servo-{episode.title}.gif", film(episode, each, own[row], found, sides[row])
        )
        rows.append([
            episode.title, str(episode.patient), str(last.step), f"{last.distance:.1f} mm",
            f"{last.believed:.1f} mm", f"{last.grade:.1f}", f"{last.read:.1f}",
            "yes" if found else "no",
        ])  # fmt: skip
        if not found:
            taken, best = (max(each, key=lambda shot, key=key: getattr(shot, key))
                           for key in ("read", "grade"))  # fmt: skip
            told = reason(core, row)
            for name, shot in (("taken", taken), ("best", best), ("end", last)):
                told[name] = {"read": round(shot.read, 1), "grade": round(shot.grade, 1)}
    columns = ["film", "patient", "steps", "to the view", "believed", "grade", "read", "found"]
    return {"figures": told, "tables": {"episodes": {"columns": columns, "rows": rows}}}


def main() -> None:
    """Draw the films of the rule's episodes, and write what is told of them."""
    about = {
        "schema": "racines.figures/1",
        "machine": "one core of an AMD EPYC (Zen 4)",
        "source": "measured once",
        "what": "films of the servo on A4C of beating hearts of test patients: how they end, and "
        "what the failure's last plane shows beside the patient's own",
        "command": "python -m tests.envs.studies.films",
    }
    write_json(RESULT, about | make(chosen(), "test", IMAGES))


if __name__ == "__main__":
    main()
