"""The commands `racines data card` and `racines study sheet`. Heavy imports stand inside."""

import json
from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt


def card(
    root: opt.Root = None,
    realism: Annotated[
        list[Path] | None,
        typer.Option(help="Report of racines study realism on it; repeat for several."),
    ] = None,
    picture: Annotated[
        list[Path] | None, typer.Option(help="PNG shown with the report; repeat for several.")
    ] = None,
    draw: Annotated[bool, typer.Option("--draw", help="Draw the other pictures again.")] = False,
    as_json: opt.AsJson = False,
) -> None:
    """Write a dataset's card anew, with realism figures where given; the content stays."""
    from racines_data.card.rewrite import rewrite_card
    from racines_data.manifest import CARD, default_root

    folder = default_root(root)
    manifest = rewrite_card(folder, realism or (), picture or (), draw)
    if as_json:
        record = manifest["files"][CARD]
        shown = [name for name in manifest["files"] if name.startswith("card/")]
        told = {"card": str(folder / CARD), **record, "pictures": shown}
        typer.echo(json.dumps({**told, "digest": manifest["digest"]}))
    else:
        typer.echo(
            f"{folder / CARD}: written, {len(manifest.get('realism', []))} realism report(s)"
        )


def sheet(
    out: opt.OutFile = Path("docs/images/contact_sheet.png"),
    anatomy: Annotated[str, typer.Option(help="Name of an anatomy.")] = "heart",
    anatomy_seed: Annotated[int, typer.Option(help="0 is the canonical organ.")] = 0,
    seed: opt.DrawSeed = 0,
) -> None:
    """Draw a contact sheet: every view at falling grades, and `Random` scans."""
    from racines_data.phantom import Phantom, PhantomConfig
    from racines_data.phantom.figures import contact_sheet

    contact_sheet(Phantom(PhantomConfig(anatomy=anatomy, anatomy_seed=anatomy_seed)), out, seed)
    typer.echo(f"wrote {out}")
