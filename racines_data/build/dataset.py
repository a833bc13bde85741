"""Building a dataset: one writer, whatever the source.

    source.plan() ─> staged units ─> groups by (split, held-out session) ─> Parquet shards
                                                                         └> training store
    and, where there are many hearts, the same for them under `multi_phantom`, split by heart
                  ─> manifest.json, README.md, canonical frames, import report ─> swapped in place

Nothing of the result depends on the time, the number of workers or the order they finish in.
"""

import dataclasses
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from racines_data.build import beside, writer
from racines_data.build.planning import FORMAT, DataConfig, check_part, own_splits, plan_units
from racines_data.build.staging import stage_units, staging_folder
from racines_data.config import Settings, fill, section
from racines_data.digest import recipe_digest
from racines_data.engines import Engine
from racines_data.engines.local import LocalEngine
from racines_data.errors import RacinesError
from racines_data.files import locked_place, recover_folder, swap_folder
from racines_data.manifest import ADDED, MANIFEST, MULTI_PHANTOM
from racines_data.sources.base import Source, held_card, source_class, source_names
from racines_data.sources.gate.bounds import bounds_of
from racines_data.sources.licence import declared_card


def read_data_section(values: Mapping[str, Any]) -> tuple[DataConfig, dict[str, Settings]]:
    """Split the `data` section of a params file into the builder's part and the sources' parts.

    Beside the sources, `multi_phantom` has a section of its own.

    Raises:
        RacinesError: an unknown key, or a value of the wrong type.
    """
    names = (*source_names(), MULTI_PHANTOM)
    sections = {name: section(values, name) for name in names if name in values}
    rest = {name: value for name, value in values.items() if name not in sections}
    return fill(DataConfig, Settings(rest, getattr(values, "file", "")), "data"), sections


def make_source(
    config: DataConfig, section: dict[str, Any] | None = None, inputs: Sequence[Path] = ()
) -> Source:
    """Make the source that a config names; it gets `frames`, `seed`, `allow` if it can.

    Raises:
        RacinesError: no such source, or it refuses its settings or inputs.
    """
    kind = source_class(config.source)
    known = {field.name for field in dataclasses.fields(kind.Config)}
    given = {name: getattr(config, name) for name in ("frames", "seed", "allow") if name in known}
    return kind.from_config(given | (section or {}), inputs)


def make_multi_phantom(
    source: Source, config: DataConfig, section: dict[str, Any] | None = None
) -> Source | None:
    """Make the source of many hearts that goes with the phantom; none if no hearts are asked for.

    Other sources have no other hearts: the section is then left unread.
    """
    from racines_data.sources.phantom import MultiPhantomSource, PhantomSource

    if not isinstance(source, PhantomSource):
        return None
    settings = {"seed": config.seed} | (section or {})
    many = MultiPhantomSource.from_config(settings, acquisition=source.config)
    return many if many.config.hearts else None


def make_also(config: DataConfig, sections: Mapping[str, Settings]) -> list[Source]:
    """Make the sources that a config has add a config each, before anything is built.

    Raises:
        RacinesError: no such source, one that adds nothing, or it refuses its settings.
    """
    made = []
    for name in config.also:
        if not getattr(source_class(name), "adds", ""):
            raise RacinesError(
                f"data.also: source {name} adds no config to a dataset: name one of "
                f"{', '.join(ADDED)}, or build it by itself with --source"
            )
        made.append(make_source(dataclasses.replace(config, source=name), sections.get(name)))
    return made


def build(
    source: Source,
    out: Path,
    config: DataConfig | None = None,
    progress: bool = False,
    many: Source | None = None,
    engine: Engine | None = None,
) -> dict[str, Any]:
    """Build a dataset and swap it into place; a build that was killed goes on where it stopped.

    Args:
        source: Where the trajectories come from.
        out: Folder of the dataset. An older dataset there is replaced when the new one is whole,
            but for configs that other sources have added. A source that adds one (`adds`) leaves
            all others as they are.
        config: Splits, shards, workers, limits.
        progress: Show a progress bar on stderr.
        many: Source of the config `multi_phantom`; each of its sessions is one heart.
        engine: Who makes the frames, started; `config.workers` processes here by default.

    Returns:
        The manifest; as it is of the added config, where one was.

    Raises:
        RacinesError: the source refuses its input, too much is refused, `out` holds something
            else, or another build of it is running.
    """
    config = config or DataConfig()
    out = out.resolve()  # a link to the dataset stays a link
    recover_folder(out)
    if config.workers < 1 or config.shards < 1:
        raise RacinesError("data.workers and data.shards must be one or more")
    engine = engine or LocalEngine(config.workers)
    if not re.fullmatch(r"\d+\.\d+\.\d+", source.version):
        raise RacinesError(f"source {source.name}: version {source.version!r} is not x.y.z")
    if getattr(source, "adds", ""):
        return beside.add_config(source, out, config, engine, progress)
    if out.exists() and not (out / MANIFEST).is_file() and (out.is_file() or any(out.iterdir())):
        raise RacinesError(f"{out}: exists and is not a dataset; name another --out or remove it")
    bounds = bounds_of(source, config.allow)
    card = declared_card(source, config.licence, config.consent, config.origin)
    units = plan_units(source, config)
    many_units = [] if many is None else plan_units(many, config)
    recipe = _recipe(source, config, many)
    out.parent.mkdir(parents=True, exist_ok=True)
    with staging_folder(out, source, recipe_digest(recipe), config.allow) as folder:
        shares = config.validation, config.test, config.seed
        splits = own_splits(units) or writer.assign_splits(units, *shares)
        held = writer.held_out_session(units)
        main = writer.Part("frames", source, units, splits, folder / "frames", held)
        part, parts = None, [(source, units, main.folder, False)]
        if many is not None:
            splits = writer.assign_group_splits(many_units, *shares)
            part = writer.Part(MULTI_PHANTOM, many, many_units, splits, folder / MULTI_PHANTOM)
            parts.append((many, many_units, part.folder, True))
        stage_units(parts, engine, progress, config.allow)
        for each in filter(None, (main, part)):
            check_part(each, bounds.allow)
        final = folder / f"final-{config.shards}"  # what is whole there has the same bounds
        manifest = writer.write_dataset(
            final, main, part, recipe, config.shards, progress, bounds, held_card(card)
        )
        with locked_place(out):
            beside.carry(out, final, manifest)
            swap_folder(final, out)
    return manifest


def recipe_of(values: Mapping[str, Any], added: str | None = None) -> str:
    """Return the recipe digest of the dataset that a `data` section builds; nothing is built.

    Args:
        values: The section. The recipe of recordings is known once they are read: they are refused.
        added: A config that one of the sources of `also` adds, whose own recipe is asked for.

    Raises:
        RacinesError: settings at fault, recordings, or no source that adds such a config.
    """
    config, sections = read_data_section(values)
    if added is not None:
        others = {getattr(each, "adds", ""): each for each in make_also(config, sections)}
        if added not in others:
            raise RacinesError(f"data.also: no source there adds config {added!r}")
        return recipe_digest(beside.added_recipe(others[added]))
    source = make_source(config, sections.get(config.source))
    many = make_multi_phantom(source, config, sections.get(MULTI_PHANTOM))
    return recipe_digest(_recipe(source, config, many))


def peak_memory(workers: int) -> int:
    """Return an upper bound of the bytes that this process and its workers held at once.

    The most that this process has held, and as often as there are workers the most that any one
    process that it has started and awaited has held; what they share is counted several times.
    Windows tells nothing of it: 0.
    """
    if sys.platform == "win32":  # which counts neither
        return 0
    import resource

    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    child = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * (own + (workers * child if workers > 1 else 0))


def _recipe(source: Source, config: DataConfig, many: Source | None) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "source": source.name,
        "version": source.version,
        "splits": {"seed": config.seed, "validation": config.validation, "test": config.test},
        "settings": source.recipe(),
        **({} if many is None else {MULTI_PHANTOM: many.recipe()}),
    }
