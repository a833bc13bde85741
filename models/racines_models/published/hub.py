"""Published weights on the Hugging Face Hub: a model repository a set, taken by its files' tag.

The tag follows from the manifest's sha256 of every file, so that a checkout finds the very files
that its records name, whatever was pushed since.
"""

import glob
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from racines_data.digest import recipe_digest
from racines_data.errors import RacinesError
from racines_data.files import write_atomic
from racines_data.hub import hub_errors, hub_files
from racines_models.published.catalogue import Catalogue, WeightsSet, broken_files, problem_of

if TYPE_CHECKING:
    from huggingface_hub import HfApi

KIND = "model"
DESCRIBED = "config.json"
"""Written last: a folder that has one is whole."""


def repository(owner: str, weights: WeightsSet) -> str:
    """Return the repository of a set, such as OWNER/racines-phantom-default-ppo.

    Raises:
        RacinesError: no name of an owner.
    """
    from huggingface_hub.errors import HFValidationError
    from huggingface_hub.utils import validate_repo_id

    repo_id = f"{owner}/racines-{weights.name.replace('/', '-')}"
    try:
        validate_repo_id(repo_id)
    except HFValidationError as error:
        raise RacinesError(f"{owner}: not an owner's name on the Hub ({error})") from error
    return repo_id


def tag_of(weights: WeightsSet) -> str:
    """Return the tag of a set's files, such as `weights-0a1b2c3d4e5f`: other files, another tag."""
    return f"weights-{recipe_digest(weights.files)[:12]}"


def fetch(
    catalogue: Catalogue, weights: WeightsSet, owner: str, api: "HfApi | None" = None
) -> list[str]:
    """Take from the Hub what is missing or damaged of a set; return the names of those files.

    Nothing is written before every file has the size and sha256 of the manifest.

    Args:
        catalogue: The manifest and its checkout.
        weights: The set.
        owner: Who has the repositories on the Hub.
        api: Client of the Hub.

    Raises:
        RacinesError: no such repository or tag, no network, or files that are not as published.
    """
    from huggingface_hub import HfApi

    broken = broken_files(catalogue, [weights])
    names = [str(Path(each["file"]).relative_to(weights.folder)) for each in broken]
    if not names:
        return []
    client, tag = api or HfApi(library_name="racines"), tag_of(weights)
    repo_id = repository(owner, weights)
    remedy = f"check the name and the network; it has to have the tag {tag}"
    with TemporaryDirectory() as folder, hub_errors(repo_id, remedy):
        there = hub_files(client, repo_id, tag, KIND)
        for name in names:  # before anything is transferred
            size = getattr(there.get(name), "size", None)
            if size != weights.files[name]["bytes"]:
                found = "is not there" if size is None else f"has {size} bytes"
                raise RacinesError(f"{repo_id}: {name} {found}, not what the manifest names")
        client.snapshot_download(
            repo_id, repo_type=KIND, revision=tag, local_dir=folder,
            allow_patterns=[glob.escape(name) for name in names],
        )  # fmt: skip
        for name in names:
            if problem := problem_of(Path(folder, name), weights.files[name]):
                raise RacinesError(f"{repo_id}: {name} is {problem}; nothing was written")
        for name in sorted(names, key=lambda each: (Path(each).name == DESCRIBED, each)):
            place = catalogue.root / weights.folder / name
            write_atomic(place, Path(folder, name).read_bytes())
    return names
