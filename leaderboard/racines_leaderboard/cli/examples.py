"""The examples at the end of each command's help, and the exit codes at the end of the root's."""

EXIT_CODES = {
    0: "done",
    1: "refused or broken: the reason stands on stderr",
    2: "bad usage: see --help",
    3: "an audit could not verify something",
}
EXAMPLES = {
    "doctor": "racines doctor",
    "weights list": "racines weights list",
    "weights verify": "racines weights verify",
    "weights card": "racines weights card scene-field --out card.md",
    "weights fetch": "racines weights fetch grader --hub OWNER",
    "weights push": "racines weights push OWNER --dry-run",
    "data build": "racines data build --profile smoke",
    "data import": "racines data import recording --source table --mapping mapping.yaml",
    "data map": "racines data map recording --guess",
    "data inspect": "racines data inspect recording",
    "data validate": "racines data validate data/racines",
    "data annotate": "racines data annotate data/racines",
    "data card": "racines data card data/racines",
    "data export": "racines data export data/racines --format release --out exported",
    "data push": "racines data push OWNER/NAME --dry-run",
    "data pull": "racines data pull OWNER/NAME",
    "phantom from-mesh": "racines phantom from-mesh meshes --tissues tissues.yaml --out mine",
    "phantom from-labels": "racines phantom from-labels map.nii --tissues tissues.yaml --out mine",
    "train grader": "racines train grader --profile smoke",
    "train student": "racines train student --profile smoke",
    "train pose": "racines train pose --profile smoke",
    "train segmentation": "racines train segmentation --profile smoke",
    "train motion": "racines train motion pair-cnn",
    "train encoder": "racines train encoder --profile smoke",
    "train generator": "racines train generator vae-gan --profile smoke",
    "train agent": "racines train agent ppo --profile smoke",
    "eval generator": "racines eval generator vae-gan --profile smoke",
    "eval grader": "racines eval grader",
    "eval motion": "racines eval motion no-motion",
    "eval agent": "racines eval agent planner --profile smoke",
    "eval robustness": "racines eval robustness planner --profile smoke",
    "export generator": "racines export generator vae-gan --out vae-gan.onnx",
    "export agent": "racines export agent envs/weights/ppo --out ppo.onnx",
    "export weights": "racines export weights models/runs/vae-gan",
    "export poses": "racines export poses --out poses.parquet",
    "export predictions": "racines export predictions mean-image --out predictions.parquet",
    "export motion": "racines export motion no-motion --out motion.npz",
    "export envhub": "racines export envhub SC --out envhub",
    "export trace": "racines export trace planner --out trace.json",
    "board pin": "racines board pin phantom-default",
    "board commit-secret": "racines board commit-secret phantom-default",
    "board reveal": "racines board reveal phantom-default --secret secret.json",
    "expert sample": "racines expert sample --out kit",
    "expert rate": "racines expert rate kit",
    "expert score": "racines expert score kit ratings.jsonl",
    "demo": "racines demo --patient 20035",
    "drive": "racines drive",
    "replay": "racines replay episode_0000.jsonl",
    "explain": "racines explain ppo --profile smoke",
    "submit": "racines submit submission.yaml --check",
    "leaderboard": "racines leaderboard --html leaderboard.html",
    "audit": "racines audit ppo --board phantom-default",
    "studio": "racines studio",
}
"""A line that works, or shows the shape where it takes what is one's own; studies have none."""


def epilog_of(words: str) -> str | None:
    """Return the end of a command's help; None where there is no example."""
    line = EXAMPLES.get(words)
    return f"\b\nExample:\n  {line}" if line else None


def root_epilog() -> str:
    """Return the end of the root's help: exit codes, and what to run first."""
    codes = "\n".join(f"  {code}  {meaning}" for code, meaning in EXIT_CODES.items())
    return f"\b\nExit codes:\n{codes}\n\n\b\nFirst:\n  racines doctor"
