"""A Ray cluster of two nodes on this machine, until standard input is closed; a process of its own, without JAX."""

from __future__ import annotations

import sys

from ray.cluster_utils import Cluster

if __name__ == "__main__":
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    cluster.add_node(num_cpus=1)
    print(cluster.address, flush=True)
    if sys.stdin.readline().strip() == "kill":
        for process in list(cluster.head_node.all_processes.values()):
            for part in process:
                part.process.kill()
    cluster.shutdown()
