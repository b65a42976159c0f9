"""Estimators: from windows of a drive to the parameters of a model."""
