"""The two reports: of one mission, and of a comparison with the paper."""

from skysweep.experiments.paper.report import write_compare_report
from skysweep.results.run_report import write_run_report

__all__ = ["write_compare_report", "write_run_report"]
