"""The cluster that the page describes, and eight simulated nodes."""

import pytest
import yaml

from tests.conftest import ROOT


def test_the_clusters_description_fits_rays_schema():
    from ray.autoscaler._private.util import prepare_config, validate_config

    described = yaml.safe_load((ROOT / "docs/assets/cluster.yaml").read_text())
    validate_config(prepare_config(described))
    with pytest.raises(Exception, match="max_worker"):
        validate_config(prepare_config(described | {"max_worker": 8}))


@pytest.mark.thorough
def test_eight_nodes_share_the_work_and_one_may_go():
    """Ray has one cluster a process: this one is another's."""
    import subprocess
    import sys

    code = "from tests.benchmarks import scale; import json; print(json.dumps(scale.of_nodes()))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    told = yaml.safe_load(done.stdout.strip().splitlines()[-1])
    assert told["used"] == told["nodes"] == 8 and told["fewest"] >= 1
    assert told["after_a_loss"] == told["asked"]
