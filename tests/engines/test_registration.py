"""``import up_samp`` registers names; what they need is imported when it is used."""

import json
import subprocess

import pytest
from unified_planning.engines import Engine

from up_samp.system import child

HEAVY = ("numpy", "numba", "scipy", "ortools", "shapely", "ompl", "matplotlib", "PIL", "networkx")


def run(code):
    done = subprocess.run(
        child.command(code), env=child.environment(), capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_import_is_light_and_the_environment_is_made_when_used():
    found = run(
        "import json, sys, up_samp\n"
        f"early = [m for m in {HEAVY} if m in sys.modules]\n"
        "import unified_planning.environment as e\n"
        "env = e.get_environment()\n"
        "env.credits_stream = None\n"
        "names = env.factory.engines\n"
        "late = [m for m in ('numba', 'scipy', 'shapely', 'ompl', 'matplotlib')"
        " if m in sys.modules]\n"
        "print(json.dumps([early, late, names, type(env) is e.Environment,"
        " env is e.get_environment(), env.credits_stream, up_samp.trajectories.__name__,"
        " sorted(up_samp.__all__) == sorted(set(dir(up_samp)) & set(up_samp.__all__))]))\n"
    )
    early, late, names, plain, same, stream, function, listed = found
    assert (early, late) == ([], [])
    assert {"cpsat", "samp-validator", "samp-refine[cpsat]", "samp-refine[aries]"} <= set(names)
    assert (plain, same, stream, function, listed) == (True, True, None, "trajectories", True)


@pytest.mark.parametrize(
    "use",
    [
        "import pickle; e = pickle.loads(pickle.dumps(get_environment()))",
        *(
            pytest.param(use, marks=pytest.mark.long)
            for use in (
                "import copy; e = copy.copy(get_environment())",
                "e = get_environment(); e.error_used_name = False; assert not e.error_used_name",
                "e = get_environment(); assert hasattr(e, 'factory') and not hasattr(e, 'no')",
                "e = Problem('p').environment",
                "e = get_environment(); up_samp.register(e); up_samp.register()",
            )
        ),
    ],
)
def test_the_global_environment_is_like_any_other(use):
    names = run(
        "import json, up_samp\n"
        "from unified_planning.shortcuts import *\n"
        f"{use}\n"
        "print(json.dumps(e.factory.engines))\n"
    )
    assert names.count("cpsat") == names.count("samp-refine[cpsat]") == 1


def test_an_environment_that_is_there_already_gets_the_engines():
    names = run(
        "import json\nfrom unified_planning.shortcuts import *\n"
        "before = get_environment().factory.engines\nimport up_samp\n"
        "print(json.dumps([before, get_environment().factory.engines]))\n"
    )
    assert "cpsat" not in names[0]
    assert "cpsat" in names[1]


def test_an_environment_of_one_s_own_has_none_until_asked():
    from unified_planning.environment import Environment

    import up_samp

    own = Environment()
    assert "cpsat" not in own.factory.engines
    up_samp.register(own)
    assert issubclass(own.factory.engine("samp-refine[cpsat]"), Engine)


def test_unknown_names_are_attribute_errors():
    import up_samp
    import up_samp.plotting

    for module in (up_samp, up_samp.plotting):
        with pytest.raises(AttributeError, match="nonesuch"):
            _ = module.nonesuch
