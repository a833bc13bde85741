"""Learning curves: read from a finished run and from one under way, joined by label, drawn."""

import json

import numpy as np
import pytest

from racines_data.errors import RacinesError
from racines_envs.studies.curves import draw_curves, joined, read_curves


def run_folder(folder, rows, seed=0, finished=True, **config):
    """Write what a training leaves."""
    config = {"view": "SC", "observation": "image", "reward": "oracle"} | config
    folder.mkdir()
    described = {"agent": "ppo", "config": config, "seed": seed}
    (folder / "config.json").write_text(json.dumps(described))
    tables = folder / "dvclive" / "plots" / "metrics"
    for name in ("validation/success", "validation/return", "train/return"):
        (tables / name).parent.mkdir(parents=True, exist_ok=True)
        lines = [f"{frames}\t{value}" for frames, value in rows]
        (tables / f"{name}.tsv").write_text("\n".join(["step\tx", *lines, ""]))
    if finished:
        history = [{"frames": f, "validation/success": v / 2} for f, v in rows]
        (folder / "metrics.json").write_text(json.dumps({"history": history}))
    return folder


def test_a_finished_run_is_read_from_its_history_and_one_under_way_from_its_tables(tmp_path):
    done = run_folder(tmp_path / "done", [(100, 0.2), (200, 0.8)], seed=5)
    rows = [(100, 0.2), (300, 0.5), (200, 0.1), (300, 0.6)]  # killed at 300, resumed from 100
    going = run_folder(tmp_path / "going", rows, finished=False)
    first, second = read_curves([str(done), f"again={going}"])["runs"]
    assert first["curves"]["validation/success"] == [[100, 0.1], [200, 0.4]]
    assert first["curves"]["train/return"] == [[100, 0.2], [200, 0.8]]
    assert (first["label"], first["seed"], second["label"]) == ("done", 5, "again")
    assert second["curves"]["validation/success"] == [[100, 0.2], [200, 0.1], [300, 0.6]]


def test_seeds_are_joined_at_all_their_steps():
    steps, mean, low, high = joined([[[0, 0.0], [100, 1.0]], [[0, 1.0], [50, 1.0], [80, 1.0]]])
    np.testing.assert_array_equal(steps, [0, 50, 80])
    np.testing.assert_allclose(mean, [0.5, 0.75, 0.9])
    np.testing.assert_allclose((low, high), [[0, 0.5, 0.8], [1, 1, 1]])


def test_labels_and_the_papers_levels_are_drawn(tmp_path, monkeypatch):
    from matplotlib.axes import Axes

    written, plotted = [], []
    annotate, plot = Axes.annotate, Axes.plot

    def noted(axes, text, *rest, **more):
        written.append(text)
        return annotate(axes, text, *rest, **more)

    def lined(axes, *rest, **more):
        plotted.append(more.get("label"))
        return plot(axes, *rest, **more)

    monkeypatch.setattr(Axes, "annotate", noted)
    monkeypatch.setattr(Axes, "plot", lined)
    for seed in (0, 1):
        run_folder(tmp_path / f"s{seed}", [(100, 0.2 + seed / 10), (200, 0.8)], seed=seed)
    specs = [f"image={tmp_path / name}" for name in ("s0", "s1")]
    draw_curves(read_curves(specs), tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 10000
    assert written == ["paper, image: about 140"]
    assert plotted == ["image, 2 seeds: mean, range"] * 3
    written.clear()
    shaped = run_folder(tmp_path / "shaped", [(100, 0.2), (200, 0.8)], reward="shaped")
    draw_curves(read_curves([str(shaped)]), tmp_path / "shaped.png")
    draw_curves(read_curves(specs), tmp_path / "plain.png", paper=False)
    assert written == [], "other rewards do not compare with the paper's"


def test_what_has_no_curve_is_refused(tmp_path):
    with pytest.raises(RacinesError, match="no such run folder"):
        read_curves([str(tmp_path / "none")])
    with pytest.raises(RacinesError, match="no validations"):
        read_curves([str(tmp_path)])
    with pytest.raises(RacinesError, match="no run given"):
        read_curves([])
    folder = run_folder(tmp_path / "bad", [(100, "?")], finished=False)
    with pytest.raises(RacinesError, match=r"success\.tsv"):
        read_curves([str(folder)])
