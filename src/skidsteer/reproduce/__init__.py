"""The papers' tables beside ours, a module for each paper."""

from skidsteer.reproduce.rows import Row, Verdict, compared

__all__ = ["Row", "Verdict", "compared"]
