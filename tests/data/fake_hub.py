"""The Hub in memory: the calls of `HfApi` that we make, with its signatures and its refusals."""

import hashlib
import inspect
import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from huggingface_hub import HfApi
from huggingface_hub.utils import filter_repo_objects

Tree = dict[str, bytes]
LARGE = (".parquet", ".safetensors", ".onnx")
"""Files of which the Hub tells the sha256."""


def as_in_the_api(method: Callable) -> Callable:
    """Bind the arguments by the signature of the real method first: it must take them."""
    real = inspect.signature(getattr(HfApi, method.__name__))

    def call(self: "FakeHub", *args: Any, **kwargs: Any) -> Any:
        bound = real.bind(self, *args, **kwargs)
        self.calls.append(method.__name__)
        arguments = dict(itertools.islice(bound.arguments.items(), 1, None))
        assert arguments.pop("repo_type") == self.kind
        return method(self, **arguments)

    return call


@dataclass
class Repository:
    branches: dict[str, str] = field(default_factory=lambda: {"main": "c0"})
    tags: dict[str, str] = field(default_factory=dict)
    commits: dict[str, Tree] = field(default_factory=lambda: {"c0": {".gitattributes": b""}})
    private: bool | None = None

    def tree(self, revision: str) -> Tree:
        return self.commits[self.tags.get(revision) or self.branches.get(revision) or revision]


@dataclass
class FakeHub:
    repositories: dict[str, Repository] = field(default_factory=dict)
    calls: list[str] = field(default_factory=list)
    sent: list[str] = field(default_factory=list)
    """Paths that were really transferred."""
    fail_after: int | None = None
    """Files that an upload transfers before the connection breaks."""
    damage: str = ""
    """A file that arrives empty."""
    kind: str = "dataset"
    """Of all repositories: `dataset` or `model`."""

    @as_in_the_api
    def create_repo(self, repo_id: str, private: bool | None = None, exist_ok: bool = False):
        assert exist_ok
        self.repositories.setdefault(repo_id, Repository(private=private))

    @as_in_the_api
    def create_branch(self, repo_id: str, branch: str, exist_ok: bool = False):
        branches = self.repositories[repo_id].branches
        branches.setdefault(branch, branches["main"])

    @as_in_the_api
    def list_repo_refs(self, repo_id: str):
        if repo_id not in self.repositories:
            raise ConnectionError("404 repository not found")
        tags = self.repositories[repo_id].tags
        return SimpleNamespace(
            tags=[SimpleNamespace(name=name, target_commit=to) for name, to in tags.items()]
        )

    @as_in_the_api
    def list_repo_tree(self, repo_id: str, recursive: bool, revision: str):
        assert recursive
        yield SimpleNamespace(path="data", tree_id="a folder")
        for path, content in self.repositories[repo_id].tree(revision).items():
            sha256 = hashlib.sha256(content).hexdigest()
            lfs = SimpleNamespace(sha256=sha256) if path.endswith(LARGE) else None
            yield SimpleNamespace(path=path, size=len(content), lfs=lfs)

    @as_in_the_api
    def upload_folder(
        self,
        repo_id: str,
        folder_path: Path,
        revision: str,
        delete_patterns: list[str],
        commit_message: str,
        commit_description: str,
        allow_patterns: list[str] | None = None,
    ):
        folder_path = Path(folder_path)
        repository = self.repositories[repo_id]
        names = [p.relative_to(folder_path).as_posix() for p in folder_path.rglob("*.*")]
        names = [name for name in names if (folder_path / name).is_file()]
        sent = set(filter_repo_objects(names, allow_patterns=allow_patterns))
        old = repository.tree(revision)
        gone = set(filter_repo_objects(old, allow_patterns=delete_patterns)) - sent
        tree = {p: content for p, content in old.items() if p not in gone or p[0] == "."}
        for count, name in enumerate(sorted(sent)):
            content = (folder_path / name).read_bytes()
            if tree.get(name) == content:
                continue
            if count == self.fail_after:
                raise ConnectionError("the connection broke")
            self.sent.append(name)
            tree[name] = b"" if name == self.damage else content
            commit = f"c{len(repository.commits)}"  # a batch is a commit
            repository.commits[commit] = dict(tree)
            repository.branches[revision] = commit
        return SimpleNamespace(oid=repository.branches[revision])

    @as_in_the_api
    def create_tag(self, repo_id: str, tag: str, tag_message: str, revision: str):
        tags = self.repositories[repo_id].tags
        assert tag not in tags, "409 conflict"
        tags[tag] = revision

    @as_in_the_api
    def hf_hub_download(self, repo_id: str, filename: str, revision: str):
        return self.place(repo_id, revision, [filename], self.folder) + f"/{filename}"

    @as_in_the_api
    def snapshot_download(
        self, repo_id: str, revision: str, local_dir=None, ignore_patterns=None, allow_patterns=None
    ):
        tree = self.repositories[repo_id].tree(revision)
        patterns = {"ignore_patterns": ignore_patterns, "allow_patterns": allow_patterns}
        wanted = filter_repo_objects(tree, **patterns)
        return self.place(repo_id, revision, [*wanted], Path(local_dir or self.folder / revision))

    folder: Path = Path()

    def place(self, repo_id: str, revision: str, names: list[str], folder: Path) -> str:
        for name in names:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(self.repositories[repo_id].tree(revision)[name])
        return str(folder)
