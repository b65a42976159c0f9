"""Figures for papers: vector drawings at the width of a column, the same file every time."""
