# pyright: strict
"""Which seeds are whose: the splits of the patients, written down once.

Development looks at validation patients. Test is run once, and secret rounds draw from seeds that
no release names.
"""

from racines_data.errors import RacinesError

SPLITS = {
    "train": range(1, 10_000),
    "validation": range(10_000, 11_000),
    "test": range(20_000, 20_140),
}
"""Seeds by split; those in between belong to nobody."""
SECRET = "secret"
FIRST_SECRET = 1_000_000
"""Seeds from here up are for secret rounds."""


def split_of(seed: int) -> str:
    """Return the split of a patient's seed.

    Raises:
        RacinesError: a seed of no split.
    """
    for name, seeds in SPLITS.items():
        if seed in seeds:
            return name
    if seed >= FIRST_SECRET:
        return SECRET
    known = ", ".join(f"{name} {seeds[0]}-{seeds[-1]}" for name, seeds in SPLITS.items())
    raise RacinesError(f"seed {seed} is no patient's: {known}, {SECRET} {FIRST_SECRET} and up")


def seeds_of(split: str) -> range:
    """Return the seeds of a split.

    Raises:
        RacinesError: an unknown split, or the secret one, whose seeds nobody lists.
    """
    if split == SECRET:
        raise RacinesError(f"split {SECRET!r} has no list: name its seeds, {FIRST_SECRET} and up")
    if split not in SPLITS:
        known = ", ".join((*SPLITS, SECRET))
        raise RacinesError(f"unknown split {split!r}: choose one of {known}")
    return SPLITS[split]


def check_split(seeds: list[int], split: str) -> None:
    """Refuse seeds that are not of a split.

    Raises:
        RacinesError: an unknown split, or a seed of another one, named with its own.
    """
    if split != SECRET:
        seeds_of(split)
    for seed in seeds:
        if (own := split_of(seed)) != split:
            raise RacinesError(f"seed {seed} is a patient of {own}, not of {split}: name {own}")
