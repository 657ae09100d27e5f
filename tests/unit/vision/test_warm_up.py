"""After the warm-up nothing is compiled any more: the first order of a day is as quick as the others."""

from __future__ import annotations

import json
import subprocess
import sys

FRESH = """
import importlib, json, pkgutil
import vision
from numba.core.dispatcher import Dispatcher

FOUND = {}
for module in pkgutil.iter_modules(vision.__path__):
    inside = vars(importlib.import_module("vision." + module.name))
    for name, value in inside.items():
        if isinstance(value, Dispatcher):
            FOUND[value.py_func.__module__ + "." + name] = value

from bench import own
from bench.looks import see
from vision.default import warm_up

warm_up()
before = {name: set(one.signatures) for name, one in FOUND.items()}
for family in ("A", "B", "F", "H20", "H40", "L", "N", "T"):
    for case in own.cases(family, 2, 4711):
        for method in ("default", "published"):
            see(case, method)
late = {name: sorted(map(str, set(one.signatures) - before[name])) for name, one in FOUND.items()}
late = [[name, kinds] for name, kinds in late.items() if kinds]
print(json.dumps({"known": len(before), "warm": sum(map(bool, before.values())), "late": late}))
"""
"""To be run in a process of its own: in this one other tests have compiled what they use."""


def test_looks_compile_nothing_after_the_warm_up() -> None:
    ran = subprocess.run([sys.executable, "-c", FRESH], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    told = json.loads(ran.stdout.splitlines()[-1])

    assert told["late"] == []
    # it would also hold if nothing were compiled at all
    assert told["known"] > 100
    assert told["warm"] > 40
