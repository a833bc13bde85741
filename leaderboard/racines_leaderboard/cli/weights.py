"""The commands `racines weights …`. Heavy imports stand inside, so that --help is quick."""

from typing import Annotated

import typer

from racines_data.cli import options as opt

_NAME = 30  # letters of a name: longer ones are rare
Name = Annotated[str, typer.Argument(help="Name of the weights, as racines weights list has it.")]


def list_(as_json: opt.AsJson = False) -> None:
    """List every published set of weights: what it is, its size, the boards that name it."""
    from racines_data.terminal import say, say_json
    from racines_models.published.catalogue import read_catalogue

    sets = read_catalogue().sets.values()
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


def verify(
    name: Annotated[str | None, typer.Argument(help="One set.  [default: all]")] = None,
    as_json: opt.AsJson = False,
) -> None:
    """Hash every file of the published weights; exit 1 if one is missing or damaged."""
    from racines_data.terminal import say, say_json
    from racines_models.published.catalogue import broken_files, read_catalogue

    catalogue = read_catalogue()
    sets = list(catalogue.sets.values()) if name is None else [catalogue.named(name)]
    broken = broken_files(catalogue.root, sets)
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
    from racines_leaderboard.board.model_card import model_card
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


def fetch(name: Name, as_json: opt.AsJson = False) -> None:
    """Fetch weights that are not here; so far no repository is named that has them."""
    from racines_data.errors import RacinesError
    from racines_models.published.catalogue import broken_files, read_catalogue

    catalogue = read_catalogue()
    if not broken_files(catalogue.root, [catalogue.named(name)], full=False):
        raise RacinesError(
            f"weights {name!r}: here already; racines weights verify {name} checks them"
        )
    raise RacinesError(
        f"weights {name!r}: no hub repository is named that has them: take them from a checkout, "
        f"git -C {catalogue.root} restore {catalogue.named(name).folder}"
    )
