"""Sweeps on Ray: the same table as from local processes, whatever happens to the cluster."""

import socket

import pytest

from skysweep.errors import UserError
from skysweep.experiments.engines import LocalEngine, RayEngine
from skysweep.experiments.sweep.run import Sweep
from skysweep.experiments.sweep.spec import parse_spec

pytest.importorskip("ray")

SPEC = """
name: small
scenarios:
  - scenario:
      name: field
      area: {polygon_enu_m: [[0, 0], [24, 0], [24, 12], [0, 12]]}
      home: {position_enu_m: [-2, -2]}
      generators: [{class: stop sign, pattern: uniform, count: 1, size_m: 0.9, seed: null}]
      search: {scan_altitude_agl_m: 12}
parameters:
  search.n_c: [1, .inf]
seeds: 15
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("sweep") / "whole"
    Sweep(parse_spec(SPEC, "spec.yaml"), out).fly(LocalEngine(2))
    return (out / "missions.parquet").read_bytes()


@pytest.mark.slow
def test_a_ray_started_here_makes_the_same_table_quietly(whole, tmp_path, capfd):
    Sweep(parse_spec(SPEC, "spec.yaml"), tmp_path).fly(RayEngine(workers=2))
    assert (tmp_path / "missions.parquet").read_bytes() == whole
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_a_node_killed_in_the_middle_changes_nothing(whole, tmp_path):
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        doomed, _ = cluster.add_node(num_cpus=1), cluster.add_node(num_cpus=1)
        engine = RayEngine(cluster.address)
        cpus = []

        def on_done(_error):
            cpus.append(engine.workers)
            if len(cpus) == 5:
                assert doomed.any_processes_alive()
                cluster.remove_node(doomed, allow_graceful=False)

        Sweep(parse_spec(SPEC, "spec.yaml"), tmp_path).fly(engine, on_done=on_done)
        assert cpus[0] == 3
        assert len(cpus) == 30
        assert not doomed.any_processes_alive()
        assert (tmp_path / "missions.parquet").read_bytes() == whole
    finally:
        cluster.shutdown()


@pytest.mark.parametrize("form", ["127.0.0.1:{port}", "ray://127.0.0.1:{port}", "127.0.0.1", "ray://"])
def test_no_ray_at_the_address_is_one_sentence_at_once(form, tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = form.format(port=port)
    with pytest.raises(UserError, match=f"--address {address}: ") as error:
        Sweep(parse_spec(SPEC, "spec.yaml"), tmp_path).fly(RayEngine(address))
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())
