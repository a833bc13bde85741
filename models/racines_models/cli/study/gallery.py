"""The command `racines study gallery`. Heavy imports stand inside."""

from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.terminal import say, say_json
from racines_models.cli.device import Device


def gallery(
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Generators, in the order of the columns.  [default: all with a run]"),
    ] = None,
    data: opt.Data = opt.DATA,
    runs: opt.Runs = Path("models/runs"),
    out: opt.OutFile = Path("models/runs/gallery.png"),
    split: opt.Split = "test",
    seed: opt.DrawSeed = 0,
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Draw the same held-out poses with every generator: one row a pose, the truth first."""
    from racines_data.store.frames import open_store
    from racines_models.registry import generator_names, load_generator
    from racines_models.scores.gallery import gallery_sample, write_gallery

    store = open_store(data)
    chosen = names or [name for name in generator_names() if (runs / name).is_dir()]
    drawn = {name: load_generator(name, runs / name, device) for name in chosen}
    write_gallery(out, store, gallery_sample(store, split), drawn, seed)
    if as_json:
        return say_json({"out": str(out), "generators": list(drawn)})
    say(f"{out}: {', '.join(drawn)}")
