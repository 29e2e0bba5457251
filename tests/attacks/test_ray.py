"""A Ray cluster of this machine alone is for this machine, and this user, alone."""

import os
import subprocess
import sys

import pytest

_PROGRAM = """
import glob, ipaddress, os, re
from hitl_jax.sweep.launchers.cluster import connected

def listening():
    found = {}
    for name in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in open(name).readlines()[1:]:
            words = line.split()
            if words[3] == "0A":
                number, _, _ = words[1].partition(":")
                raw = b"".join(
                    bytes.fromhex(number[i : i + 8])[::-1] for i in range(0, len(number), 8)
                )
                found[words[9]] = ipaddress.ip_address(raw)
    return found

before = listening()
with connected(None):
    import ray
    assert ray.get(ray.remote(lambda: 1).remote()) == 1
    ours = [place for inode, place in listening().items() if inode not in before]
    for place in ours:
        print(getattr(place, "ipv4_mapped", None) or place)
    print(os.environ["RAY_AUTH_MODE"])
"""


def test_a_cluster_of_this_machine_listens_to_nobody_else():
    pytest.importorskip("ray", reason='needs pip install -e ".[ray]"')
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM],
        capture_output=True,
        text=True,
        timeout=120,
        env=environment,
    )
    assert done.returncode == 0, done.stderr
    *places, mode = done.stdout.split()
    assert mode == "token"
    # Other programs of this machine may have begun to listen meanwhile: those of Ray are many.
    assert len(places) >= 4
    assert set(places) == {"127.0.0.1"}
