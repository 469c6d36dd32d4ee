"""What is put off is there when it is used."""

import subprocess
import sys

import numpy as np
import pytest

from up_samp.geometry.cells import column_distances


def _run(script):
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_cp_model_comes_without_pandas_and_gets_it_when_asked():
    pytest.importorskip("pandas")
    said = _run(
        """
import sys
from up_samp.system.imports import load_cp_model, own_the_process
own_the_process()
load_cp_model()
from ortools.sat.python import cp_model
print("pandas" in sys.modules)
model = cp_model.CpModel()
x = model.new_int_var(0, 4, "x")
model.add(2 * x >= 5)
solver = cp_model.CpSolver()
assert solver.solve(model) == cp_model.OPTIMAL
print("pandas" in sys.modules)
import pandas as pd
series = model.new_bool_var_series("b", pd.Index(["one", "two"]))
model.add(sum(series) == 1)
solver.solve(model)
values = solver.boolean_values(series)
print(isinstance(values, pd.Series), int(values.sum()))
"""
    )
    assert said == ["False", "False", "True", "1"]


def test_a_benchmark_family_comes_without_the_others_and_what_these_need():
    said = _run(
        """
import sys
from up_samp.benchmarks import instance, logistics
print(instance("navigation-r2").build().name)
print(*(name for name in sys.modules if "up_samp.benchmarks.builders." in name))
print("up_samp.fleet" in sys.modules)
print(logistics.__name__, logistics.__module__)
"""
    )
    builders = "up_samp.benchmarks.builders"
    assert said[0] == "navigation-r2"
    assert set(said[1:-3]) == {f"{builders}.logistics", f"{builders}.navigation"}
    assert said[-3:] == ["False", "logistics", f"{builders}.logistics"]


def test_planning_models_come_without_networkx_and_get_it_when_asked():
    said = _run(
        """
import sys
from up_samp.system.imports import load_unified_planning, own_the_process
own_the_process()
load_unified_planning()
from unified_planning.shortcuts import InstantaneousAction, get_environment
from unified_planning.plans import ActionInstance, PartialOrderPlan, SequentialPlan
print("networkx" in sys.modules)
first, last = (ActionInstance(InstantaneousAction(n)) for n in ("first", "last"))
plan = PartialOrderPlan({first: [last]})
print("networkx" in sys.modules)
print([a.action.name for a in next(iter(plan.all_sequential_plans())).actions])
"""
    )
    assert said == ["False", "True", "['first',", "'last']"]


def test_kernels_come_without_linear_algebra_and_can_do_it_all_the_same():
    said = _run(
        """
import sys
import numpy as np
from up_samp.system.imports import load_numba_arrays, own_the_process
import numba
own_the_process()
load_numba_arrays()
total = numba.njit(lambda a: np.min(a) + a.sum())
print(total(np.arange(4.0)), "scipy.linalg" in sys.modules)
turned = numba.njit(lambda a, b: np.dot(a, b))
print(turned(np.eye(2), np.ones(2)).sum())
print(numba.njit(lambda a: np.linalg.det(a))(np.eye(3)))
"""
    )
    assert said == ["6.0", "False", "2.0", "1.0"]


def test_loaded_kernels_need_no_compiler_and_others_get_it():
    script = """
import sys
import numba
import numpy as np
from up_samp.geometry.cells import column_distances
near = np.zeros((3, 4), dtype=np.int64)
column_distances(np.eye(3, 4, dtype=np.bool_), near)
print(int(near.sum()), "numba.np.npyimpl" in sys.modules)
print(numba.njit(lambda a: np.sort(a)[0])(np.arange(4.0)))
"""
    near_columns = [0 + 1 + 2, 1 + 0 + 1, 2 + 1 + 0, 7 + 7 + 7]  # nothing lies in the last one
    column_distances(np.eye(3, 4, dtype=np.bool_), np.zeros((3, 4), dtype=np.int64))
    # it has been compiled by now
    assert _run(script) == [str(sum(near_columns)), "False", "0.0"]


def test_a_users_interpreter_is_left_alone():
    pytest.importorskip("pandas")
    said = _run(
        """
import sys
import up_samp.scheduling.cpsat
print("pandas" in sys.modules, type(sys.modules["ortools.sat.python.cp_model"].pd).__name__)
"""
    )
    assert said == ["True", "module"]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="threads are counted in /proc")
def test_processes_of_our_own_start_no_threads_for_small_matrices():
    said = _run(
        """
import os
from up_samp.system.imports import own_the_process
own_the_process()
import numpy as np
np.linalg.inv(np.random.default_rng(0).random((300, 300)))
print(len(os.listdir("/proc/self/task")))
"""
    )
    assert said == ["1"]
