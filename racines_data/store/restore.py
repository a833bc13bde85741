"""Making the training stores of a dataset again from its shards."""

import json
from pathlib import Path

from racines_data.errors import RacinesError
from racines_data.files import sha256_file, write_atomic, write_once
from racines_data.manifest import MANIFEST, STORES, read_manifest, store_name
from racines_data.records import pixels_array
from racines_data.schema import SPLITS
from racines_data.store.sweeps import read_sweeps
from racines_data.store.writer import write_store


def restore_stores(root: Path) -> list[str]:
    """Make the training stores that a dataset names and lacks, from its shards; return their paths.

    Equal pixels and numbers; should another pyarrow lay the file out otherwise, the manifest here
    gets its sha256.

    Raises:
        RacinesError: a damaged shard, or a folder that cannot be written.
    """
    made = []
    for config in STORES:
        name = store_name(config)
        if name in read_manifest(root)["files"] and not (root / name).exists():
            try:
                write_once(root / name, lambda path, of=config: _write_store(root, of, path))
            except OSError as error:
                raise RacinesError(f"{root / name}: cannot be written ({error})") from error
            made.append(name)
    return made


def _write_store(root: Path, config: str, path: Path) -> None:
    keys = ("trajectory", "session", "target_view", "phantom")
    rows = []
    frames: dict[str, int] = dict.fromkeys(SPLITS, 0)
    for sweep in read_sweeps(root, config=config):
        rows.append({key: sweep.first(key) for key in keys})
        frames[sweep.split] += len(sweep)
    bounds, start = {}, 0
    for split, count in frames.items():
        bounds[split], start = (start, start + count), start + count
    write_store(
        path,
        lambda: (
            sweep.table.append_column("pixels", pixels_array(sweep.images()))
            for sweep in read_sweeps(root, config=config)
        ),
        rows,
        bounds,
    )
    manifest = read_manifest(root)
    record = {"sha256": sha256_file(path), "bytes": path.stat().st_size}
    if manifest["files"][store_name(config)] != record:
        manifest["files"][store_name(config)] = record
        write_atomic(root / MANIFEST, json.dumps(manifest, indent=1) + "\n")
