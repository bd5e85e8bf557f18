"""Scenes, data sets, training and evaluation of the target detector."""
