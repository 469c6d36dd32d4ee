"""First use: kernels are compiled once per machine and kept on disk."""

from __future__ import annotations

from up_samp.model import MotionModel

_done: set[MotionModel] = set()


def warm_up(model: MotionModel) -> float:
    """Compile what single motions of this kind need, if it is not compiled yet; return the
    seconds. So that a first query does not spend its time limit on compiling.
    """
    if model in _done:
        return 0.0
    _done.add(model)
    from up_samp.motion.compile import is_compiling, precompile

    return 0.0 if is_compiling() else precompile([model], several=False)
