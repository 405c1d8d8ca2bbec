"""Reports over the results of suite runs: tables, figures, a page; and models compared on the episodes they share."""

from kinebench_drake.report.suite.writing import ModelComparison, read_comparison, write_comparison, write_suite_report

__all__ = ["ModelComparison", "read_comparison", "write_comparison", "write_suite_report"]
