"""The papers' tables beside ours, a module for each paper."""
