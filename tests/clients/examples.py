"""The examples of docs/clients.md by the library that they are of, and their environments."""

from pathlib import Path

from tests.documents import blocks

ROOT = Path(__file__).parents[2]
EXAMPLES = {
    "gymnasium": "gymnasium_loop.py",
    "sb3": "sb3.py",
    "rllib": "rllib.py",
    "tianshou": "tianshou_ppo.py",
    "cleanrl": "cleanrl.py",
    "torchrl": "torchrl_ppo.py",
}
"""Those of an environment `.venv-NAME`, as `tests/clients/NAME.txt` says what is in it."""
STEPS = 2000
TASKS = ("racines/SC-v0", "racines/SC-patients-v0")


def example(client: str) -> str:
    """Return the code of a library's example."""
    found = {block.file: block.text for block in blocks(ROOT / "docs/clients.md")}
    return found[f"clients/{EXAMPLES[client]}"]


def interpreter(client: str) -> Path:
    """Return the interpreter of a library's environment, whether it is there or not."""
    return ROOT / f".venv-{client}" / "bin" / "python"
