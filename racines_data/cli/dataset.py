"""The commands `racines data validate`, `card`, `export`, `push`, `pull`, and `study sheet`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from racines_data.cli import options as opt
from racines_data.errors import RacinesError
from racines_data.files import write_atomic
from racines_data.manifest import CARD, PICTURES, default_root, digest_note, read_manifest
from racines_data.terminal import say, say_json, sized

if TYPE_CHECKING:
    from racines_data.hub.push import Push

Repository = Annotated[str, typer.Argument(metavar="REPO_ID", help="OWNER/NAME on the Hub.")]


def validate(
    root: opt.Root = None,
    against: Annotated[
        Path | None, typer.Option(help="Another build that should be the same version.")
    ] = None,
    workers: opt.Workers = 2,
    as_json: opt.AsJson = False,
) -> None:
    """Check files, digests, rows, splits, copies and statistics; exit 1 if anything is wrong."""
    from racines_data.validate import run

    folder = default_root(root)
    result = run.validate(folder, against, workers or 1, progress=not as_json)
    if as_json:
        say_json(run.to_json(result))
    else:
        run.print_validation(result)
    if not result.ok:
        broken = "; ".join(
            f"{each.name}: {each.detail}" for each in result.checks if each.binding and not each.ok
        )
        raise RacinesError(f"{folder}: not valid: {broken}")


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

    folder = default_root(root)
    manifest = rewrite_card(folder, realism or (), picture or (), draw)
    if as_json:
        told = {"card": str(folder / CARD), **manifest["files"][CARD]}
        told["pictures"] = [name for name in manifest["files"] if name.startswith(PICTURES)]
        say_json({**told, "digest": manifest["digest"]})
    else:
        say(f"{folder / CARD}: written, {len(manifest.get('realism', []))} realism report(s)")


def export(
    root: Annotated[Path, typer.Argument(help="Folder of the dataset.")],
    format: Annotated[
        str, typer.Option("--format", help="release, lerobot[-rgb|-task] or minari.")
    ],
    out: opt.Out,
    config: opt.Config = "frames",
    split: opt.OneSplit = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Frames to write, the first.")] = None,
    as_json: opt.AsJson = False,
) -> None:
    """Write a dataset, or one split, in another format; images are never compressed with loss."""
    from racines_data.export.registry import for_config, load_exporter

    exporter = for_config(load_exporter(format), config, format)
    made = exporter(root, out, split=split, limit=limit, progress=not as_json)
    if as_json:
        say_json(made)
        return
    say(
        f"{made['out']}: {made['frames']} frames in {made['trajectories']} trajectories, "
        f"format {made['format']}"
    )
    for note in made.get("notes", []):
        say(f"note: {note}")


def push(
    repo_id: Repository,
    root: Annotated[Path | None, typer.Option(help="Folder of the dataset.")] = None,
    tag: Annotated[str | None, typer.Option(help="Tag; default SOURCE-vX.Y.Z.")] = None,
    revision: Annotated[str, typer.Option(help="Branch to push to.")] = "main",
    private: Annotated[bool, typer.Option(help="Make a new repository private.")] = False,
    with_store: Annotated[
        bool, typer.Option(help="Send the training stores too; `pull` can make them again.")
    ] = False,
    dry_run: Annotated[bool, typer.Option(help="Say what would go, without network.")] = False,
    cards: opt.Cards = None,
    workers: opt.Workers = 2,
    as_json: opt.AsJson = False,
) -> None:
    """Hash a dataset's files and rows, upload it to the Hub and tag it (token: HF_TOKEN)."""
    from racines_data.hub.push import plan_push
    from racines_data.hub.push import push as push_dataset

    folder = default_root(root)
    plan = plan_push(folder, repo_id, tag, revision, with_store, workers or 1)
    if cards is not None:
        write_atomic(cards / CARD, (folder / CARD).read_bytes())
    made = plan.to_json() if dry_run else push_dataset(folder, plan, private)
    if as_json:
        say_json({**made, "private": private, "dry_run": dry_run})
    elif dry_run:
        _print_plan(plan, private)
    elif made["uploaded"]:
        say(f"{repo_id}: {len(plan.files)} files, {sized(plan.bytes)}, tag {plan.tag}")
    else:
        say(f"{repo_id}: has {plan.tag} already, with these very files")


def _print_plan(plan: "Push", private: bool) -> None:
    for name, record in sorted(plan.files.items()):
        say(f"{sized(record['bytes']):>10}  {name}")
    for name, count in sorted(plan.left_out.items()):
        say(f"{sized(count):>10}  {name}  (stays here; --with-store sends it)")
    say(
        f"would send {len(plan.files)} files, {sized(plan.bytes)}, to dataset {plan.repo_id} "
        f"({'private' if private else 'public'} if new), branch {plan.revision}, tag {plan.tag}, "
        f"content sha256 {plan.digest}"
    )


def pull(
    repo_id: Repository,
    version: Annotated[str | None, typer.Option(help="x.y.z or a tag; default the newest.")] = None,
    out: opt.OwnOut = None,
    store: Annotated[bool, typer.Option(help="Make the training stores from the shards.")] = True,
    as_json: opt.AsJson = False,
) -> None:
    """Fetch a dataset into the Hub's cache or --out, check digests, and make its training store."""
    from racines_data.hub.fetch import download

    root = download(repo_id, version, out, stores=store)
    manifest = read_manifest(root)
    if as_json:
        keys = ("source", "version", "digest", "counts")
        say_json({"root": str(root), **{key: manifest[key] for key in keys}})
    else:
        note = digest_note(manifest)
        told = f"{manifest['source']} {manifest['version']}, digests hold"
        say(f"{root}: {told}" + (f" ({note})" if note else ""))


def sheet(
    out: opt.OutFile = Path("docs/images/contact_sheet.png"),
    anatomy: Annotated[str, typer.Option(help="Name of an anatomy.")] = "heart",
    anatomy_seed: Annotated[int, typer.Option(help="0 is the canonical organ.")] = 0,
    seed: opt.DrawSeed = 0,
    as_json: opt.AsJson = False,
) -> None:
    """Draw a contact sheet: every view at falling grades, and `Random` scans."""
    from racines_data.phantom import Phantom, PhantomConfig
    from racines_data.phantom.figures import contact_sheet

    contact_sheet(Phantom(PhantomConfig(anatomy=anatomy, anatomy_seed=anatomy_seed)), out, seed)
    if as_json:
        return say_json({"out": str(out)})
    say(f"wrote {out}")
