"""The pictures of a card, drawn from the training store just before a dataset is sealed."""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from racines_data.card.frames import read_frames
from racines_data.card.statistics import CACTUS_COUNTS, card_statistics, has_paper
from racines_data.manifest import MULTI_PHANTOM, store_name
from racines_data.plotting import card_style, encode

FOLDER = "card"


def write_pictures(final: Path, manifest: dict[str, Any]) -> None:
    """Draw what there is to draw into `card/`, and note it in the manifest with the figures.

    Sets `manifest["statistics"]` (see `card_statistics`) and `manifest["pictures"]`, the names of
    the pictures drawn: `parameters`, `samples`, `shares`, `trajectories`, `hearts`. A dataset
    without poses has no `parameters` and `trajectories`, one without labels no `shares`.

    Args:
        final: The dataset's folder with its stores written.
        manifest: Its manifest so far: source, labels, recipe, configs.
    """
    from racines_data.card.paths import trajectories_figure
    from racines_data.card.plots import parameters_figure, shares_figure
    from racines_data.card.samples import hearts_figure, samples_figure

    frames = read_frames(final / store_name("frames"), manifest)
    statistics = manifest["statistics"] = card_statistics(frames)
    labelled, paper = bool((frames.views >= 0).any()), has_paper(manifest)
    figures: dict[str, Figure | None] = {}
    with card_style():
        figures["samples"] = samples_figure(frames)
        if statistics["parameters"]:
            figures["parameters"] = parameters_figure(frames, statistics, paper)
        if labelled:
            cactus = frames.labels == tuple(CACTUS_COUNTS)
            figures["shares"] = shares_figure(frames, statistics, cactus)
        if frames.has_poses:
            figures["trajectories"] = trajectories_figure(frames, manifest)
        if MULTI_PHANTOM in manifest["configs"]:
            hearts = read_frames(final / store_name(MULTI_PHANTOM), manifest)
            figures["hearts"] = hearts_figure(hearts)
        manifest["pictures"] = _save(final / FOLDER, figures)


def _save(folder: Path, figures: dict[str, Figure | None]) -> list[str]:
    folder.mkdir(parents=True, exist_ok=True)
    drawn = {name: figure for name, figure in figures.items() if figure is not None}
    for name, figure in drawn.items():
        png = encode(figure, gray=name in ("samples", "hearts"))
        (folder / f"{name}.png").write_bytes(png)
    return list(drawn)
