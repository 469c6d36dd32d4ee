"""Small SAMP problems with known optima, for Unified Planning's engine report.

``python report.py ENGINES -p up_samp.test_cases`` (``up_test_cases/report.py`` of UP, engines
registered first) runs engines and validators on them.
"""

from up_samp.test_cases.cases import get_test_cases

__all__ = ["get_test_cases"]
