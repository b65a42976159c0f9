"""The report: one self-contained HTML page by which people judge a calibration."""

from skidsteer.report.evidence import Evidence, gather
from skidsteer.report.page import page, write_report

__all__ = ["Evidence", "gather", "page", "write_report"]
