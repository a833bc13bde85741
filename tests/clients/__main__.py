"""Time all clients, each in its own environment, and write docs/results/clients.json.

python -m tests.clients
"""

import json
import sys
from typing import Any

from racines_data.files import write_atomic
from racines_data.terminal import say
from tests.clients.examples import EXAMPLES, ROOT
from tests.clients.running import run_in

OUT = ROOT / "docs/results/clients.json"
TITLES = {
    "gymnasium": "Gymnasium",
    "sb3": "Stable-Baselines3",
    "rllib": "RLlib",
    "tianshou": "Tianshou",
    "cleanrl": "a CleanRL-style loop, Gymnasium",
    "torchrl": "TorchRL",
}


def content(told: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the result file of what each client's run printed."""
    rows = [
        [
            f"{TITLES[name]} {each['version']}",
            f"{each['ours']:,}",
            f"`{each['theirs_is']}`",
            f"{each['theirs']:,}",
            f"{each['ratio']:g}",
        ]
        for name, each in told.items()
    ]
    return {
        "schema": "racines.figures/1",
        "what": "steps a second through other libraries' interfaces, 64 rows, one thread",
        "command": "make test-clients; python -m tests.clients",
        "machine": "one CPU core at 2.6 GHz, shared with other work",
        "source": "measured once",
        "figures": {
            "rllib_version": told["rllib"]["version"],
            "rllib_gymnasium": told["rllib"]["gymnasium"],
            "tianshou_version": told["tianshou"]["version"],
            "least_ratio": min(each["ratio"] for each in told.values()),
            "most_ratio": max(each["ratio"] for each in told.values()),
        },
        "tables": {
            "speed": {
                "columns": ["library", "ours, steps/s", "its own", "steps/s", "ratio"],
                "right": 1,
                "rows": rows,
            }
        },
    }


def main() -> int:
    """Time each client; a client without its environment ends it with 1."""
    told = {}
    for client in EXAMPLES:
        printed = run_in(client, str(ROOT / "tests/clients/timing.py"), client)
        told[client] = json.loads(printed.splitlines()[-1])
        say(f"{client}: {told[client]}")
    write_atomic(OUT, json.dumps(content(told), indent=1, ensure_ascii=False) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
